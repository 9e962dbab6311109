"""The wheel without extras: every command works, or says in one line which extra it needs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from roomtables.storage.export import export
from scene_builders import graph, node
from tiny_tables import build_tables, change_tables
from wheels import link_requirements

# A call of every command, and the extra that it then needs; None: it works. To a command that
# offers more than one way, a call of each.
CALLS = {
    "build": "lm",
    "classify bed lamp": None,
    "classify bed unicorn --format jsonl": None,
    "classify --input graph.json --offline": None,
    "compact": "build",
    "diff": "build",
    "evaluate rooms.jsonl --offline": None,
    "evaluate rooms.jsonl --offline --sweep": None,
    "evaluate rooms.jsonl --offline --plot rooms.svg": "report",
    "export -o packed.tar.gz": None,
    "export -o packed.tar.zst": "build",
    "gc --keep 2": None,
    "label graph.json -o labelled.json --offline": None,
    "labels check bed Lamp_2 unicorn": None,
    "labels check graph.json": None,
    "labels check hydra.yaml": "scene-graphs",
    "labels from-rooms rooms.jsonl -o flat": None,
    "labels from-rooms odd.jsonl -o odd": "robot",  # inflections of names that nobody noted
    "labels import hydra.yaml -o hydra": "scene-graphs",
    "labels list": None,
    "labels show mpcat40": None,
    "misses": None,
    "paper rooms.jsonl": "lm",
    "push file://place": None,
    "pull file://place": None,
    "pull memory://place": "remote",
    "plan": "lm",
    "report -o report.html": "build",
    "rollback": None,
    "rooms graph.json rooms.jsonl": None,
    "rooms graph.json --labelspace hydra.yaml": "scene-graphs",
    "serve": "scene-graphs",
    "show graph.json -o plan.svg": "report",
    "sql from(objects)": "build",
    "status --verify": None,
}
# Options that every command with `--tables` and `--labels` gets.
WHERE = {"--tables": "tables", "--labels": "flat"}
RUN = """
import json, sys
import click
from click.testing import CliRunner
from roomtables.cli import main

def commands(group, path=()):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), {option for param in command.params for option in param.opts}

where, options = json.loads(sys.argv[2]), dict(commands(main))
found = {}
for call in json.loads(sys.argv[1]):
    words = call.split()
    known = options[next(name for name in options if tuple(words[: len(name)]) == name)]
    more = [word for pair in where.items() if pair[0] in known for word in pair]
    result = CliRunner().invoke(main, [*words, *more])
    broken = None if isinstance(result.exception, SystemExit | None) else repr(result.exception)
    found[call] = [result.exit_code, result.stderr, broken]
print(json.dumps([[" ".join(name) for name in options], found]))
"""
FROM_PYTHON = """
import sys
from roomtables import RoomTables
print(RoomTables.open("tables", "flat").classify(["bed", "lamp"]).room)
import roomtables
try:
    roomtables.build
except roomtables.errors.MissingExtraError as error:
    print(error)
print(sorted({"duckdb", "pyarrow", "inflect", "torch", "tqdm", "yaml"} & sys.modules.keys()))
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot's folder: two versions of exported tables, a graph, a room list, a label space."""
    built, place = tmp_path_factory.mktemp("built"), tmp_path_factory.mktemp("robot")
    tables = build_tables(built)
    for change in (lambda: None, lambda: change_tables(built)):
        change()
        export(tables, "flat", built / "packed.tar")
        with tarfile.open(built / "packed.tar") as archive:
            archive.extractall(place, filter="data")
    nodes = [node("R0", 1), node("O0", 1), node("O1", 2)]
    scene = graph(nodes, [("R0", "O0"), ("R0", "O1")], {1: "bed", 2: "lamp"}, {1: "bedroom"})
    (place / "graph.json").write_text(json.dumps(scene))
    (place / "rooms.jsonl").write_text(
        '{"room_id": "1", "room": "kitchen", "objects": ["oven", "fridge"]}\n'
    )
    (place / "odd.jsonl").write_text(
        '{"room_id": "1", "room": "kitchen", "objects": ["frobnicator"]}\n'
    )
    (place / "hydra.yaml").write_text("label_names: [{label: 1, name: bed}, {label: 2, name: x}]\n")
    return place


@pytest.fixture(scope="module")
def bare(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of what the wheel asks for without extras."""
    folder = tmp_path_factory.mktemp("bare")
    (metadata,) = installed.glob("*.dist-info")
    link_requirements(PathDistribution(metadata), folder)
    return folder


def run(place: Path, installed: Path, bare: Path, *arguments: str) -> str:
    """Python on the wheel and what it asks for; none of this machine's other packages (``-S``)."""
    done = subprocess.run(
        [sys.executable, "-S", "-c", *arguments],
        cwd=place, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (installed, bare)))},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_command_works_or_names_its_extra(place: Path, installed: Path, bare: Path) -> None:
    arguments = json.dumps(list(CALLS)), json.dumps(WHERE)
    commands, found = json.loads(run(place, installed, bare, RUN, *arguments))
    called = {name for call in CALLS for name in commands if f"{call} ".startswith(f"{name} ")}
    assert called == set(commands), "add a call of the new command to CALLS"
    for call, extra in CALLS.items():
        code, stderr, broken = found[call]
        assert broken is None, call
        if extra is None:
            assert code == 0, (call, stderr)
        else:
            assert code == 1, call
            (line,) = [line for line in stderr.splitlines() if not line.startswith("warning: ")]
            assert line.startswith("error: "), call
            assert line.endswith(f"run `pip install 'roomtables[{extra}]'`"), (call, line)


def test_tables_answer_from_python_and_nothing_heavy_is_there(
    place: Path, installed: Path, bare: Path
) -> None:
    room, error, imported = run(place, installed, bare, FROM_PYTHON).splitlines()
    assert room == "bedroom"
    assert error == "roomtables.build needs an extra; run `pip install 'roomtables[lm]'`"
    assert imported == "[]"
