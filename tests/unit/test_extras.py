"""Which extra brings what is the same in the code and in pyproject.toml."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from roomtables.errors import EXTRAS, MissingExtraError, needing

tomllib = pytest.importorskip("tomllib")

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Packages whose distribution has another name, and one that transformers brings.
DISTRIBUTIONS = {
    "huggingface_hub": "transformers",
    "spark_dsg": "spark-dsg",
    "yaml": "pyyaml",
    "zmq": "pyzmq",
}


def brought_by(extra: str) -> set[str]:
    """The distributions that an extra asks for, those of the extras in it among them."""
    found = set()
    for requirement in PROJECT["optional-dependencies"][extra]:
        name = re.match(r"[\w.-]+", requirement)[0]
        inside = re.search(r"\[(.*)\]", requirement)
        if name == "roomtables":
            found |= set().union(*map(brought_by, inside[1].split(",")))
        else:
            found.add(name)
    return found


def imported(path: Path) -> Iterator[str]:
    """The top-level names that a module imports, inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module).partition(".")[0]


@pytest.mark.parametrize("package", EXTRAS)
def test_each_package_is_brought_by_its_extra(package: str) -> None:
    assert DISTRIBUTIONS.get(package, package) in brought_by(EXTRAS[package])


def test_every_other_import_is_of_a_dependency() -> None:
    dependencies = {re.match(r"\w+", text)[0] for text in PROJECT["dependencies"]}
    assert dependencies == {"click", "numpy", "tabulate"}
    known = {"roomtables", *dependencies, *EXTRAS, *sys.stdlib_module_names}
    modules = (ROOT / "src").rglob("*.py")
    assert {name for path in modules for name in imported(path)} <= known


def test_a_robot_needs_no_torch_and_lm_needs_what_a_robot_has() -> None:
    assert brought_by("robot") == {"inflect", "onnxruntime", "tokenizers"}
    assert brought_by("robot") | brought_by("build") | {"torch"} < brought_by("lm")


def test_a_missing_package_is_named_by_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError) as caught, needing("drawing"):
        import matplotlib
    assert str(caught.value) == "drawing needs an extra; run `pip install 'roomtables[report]'`"
    with pytest.raises(MissingExtraError, match=r"roomtables\[ui\]"), needing("drawing", "ui"):
        import matplotlib.figure  # noqa: F401


def test_a_package_that_no_extra_brings_is_a_fault_of_ours() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_package"), needing("drawing"):
        import no_such_package  # noqa: F401
