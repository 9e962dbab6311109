"""The lookup path runs without the heavy packages: not imported, and not even there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

import roomtables
from roomtables import build
from support import HashScorer, small_space, write_space

HEAVY = (
    "torch", "transformers", "pyarrow", "duckdb", "inflect", "tqdm", "click", "tabulate", "pandas",
)  # fmt: skip
LOOK_UP = """
import json, sys
from roomtables import RoomTables
for rule in ("query", "calibrated", "pooled"):
    tables = RoomTables.open(sys.argv[1], "small", rule=rule, offline=True)
    one = tables.classify(["sink", "toilets", "unicorn"])
    assert one.answered_by == "table" and one.probabilities and one.unknown_objects
    assert tables.classify_many([["sink"], [], ["bed", "stove"]]).rooms[1] is None
none = tables.deciding(rule="query").classify(["unicorn"])
assert none.answered_by == "none"
print(json.dumps(sorted(name for name in sys.modules if "." not in name)))
"""
COMMAND = """
import json, sys
from roomtables.cli import main
main(["classify", "sink", "bed", "--offline", "--tables", sys.argv[1], "--labels", "small",
      "--format", "jsonl"], standalone_mode=False)
print(json.dumps(sorted(name for name in sys.modules if "." not in name)))
"""
FORBID = "import sys\nfor name in {names!r}: sys.modules[name] = None\n"


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("imports")
    labels = str(write_space(root / "labels", small_space()))
    build(tables=root / "tables", scorer=HashScorer(), labels=labels)
    return root / "tables"


def run(code: str, tables: Path, python: str = sys.executable) -> str:
    command = [python, "-c", code, str(tables)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_looking_up_imports_nothing_heavy(tables: Path) -> None:
    assert set(json.loads(run(LOOK_UP, tables))).isdisjoint(HEAVY)


def test_looking_up_works_where_nothing_heavy_can_be_imported(tables: Path) -> None:
    run(FORBID.format(names=HEAVY) + LOOK_UP, tables)


def test_a_miss_without_torch_is_answered_by_nobody_and_said_once(tables: Path) -> None:
    code = FORBID.format(names=("torch", "transformers")) + (
        "from roomtables import RoomTables\n"
        "tables = RoomTables.open(sys.argv[1], 'small')\n"
        "for _ in range(3): print(tables.classify(['sink', 'unicorn']).unknown_objects)"
    )
    command = [sys.executable, "-c", code, str(tables)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "('unicorn',)\n" * 3
    assert done.stderr.count("no language model here") == 1


def test_without_inflect_unlisted_names_stay_unknown_and_it_is_said_once(tables: Path) -> None:
    code = FORBID.format(names=("inflect",)) + (
        "from roomtables import RoomTables\n"
        "from support import HashScorer\n"
        "tables = RoomTables.open(sys.argv[1], 'small', scorer=HashScorer())\n"
        "for _ in range(3):\n"
        "    found = tables.classify(['sink', 'unicorn', 'ac unit'])\n"
        "    print(found.room is not None, found.unknown_objects)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tables)],
        capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    # The plural of `ac unit` is among those that the package brings.
    assert done.stdout == "True ('unicorn',)\n" * 3
    assert done.stderr.count("pip install 'roomtables[robot]'") == 1


def test_the_command_imports_no_tensors_and_no_tables_library(tables: Path) -> None:
    answer, modules = run(COMMAND, tables).splitlines()
    assert json.loads(answer)["answered_by"] == "table"
    assert set(json.loads(modules)).isdisjoint({"torch", "transformers", "pyarrow", "duckdb"})


@pytest.mark.slow
@pytest.mark.skipif(
    "ROOMTABLES_VENV_TESTS" not in os.environ, reason="makes a venv; set ROOMTABLES_VENV_TESTS=1"
)
def test_looking_up_works_in_a_venv_of_numpy_alone(tables: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "venv", with_pip=True)
    python = str(tmp_path / "venv" / "bin" / "python")
    pip = [python, "-m", "pip", "install", "--quiet", f"numpy=={np.__version__}"]
    subprocess.run(pip, check=True)
    source = Path(roomtables.__file__).parents[1]
    code = f"import sys; sys.path.insert(0, {str(source)!r})\n" + LOOK_UP
    assert set(json.loads(run(code, tables, python))).isdisjoint(HEAVY)
