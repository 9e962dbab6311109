"""The house rules that a machine can check."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "src" / "roomtables").rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def name(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_modules_and_functions_are_short(path):
    text = path.read_text()
    assert text.count("\n") <= 300
    for function in ast.walk(ast.parse(text)):
        if isinstance(function, ast.FunctionDef):
            docstring = ast.get_docstring(function, clean=False) or ""
            lines = 1 + function.end_lineno - function.lineno - len(docstring.splitlines())
            assert lines <= 40, function.name


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_modules_say_what_they_are(path):
    tree = ast.parse(path.read_text())
    assert not tree.body or ast.get_docstring(tree)


def test_no_module_bears_the_name_of_an_exported_function():
    import roomtables

    assert not {path.stem for path in MODULES} & {"build", "evaluate"}
    for exported in roomtables.__all__:
        assert getattr(roomtables, exported)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target
