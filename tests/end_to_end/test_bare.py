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
 inflections of names that nobody noted  "build": "lm",
 inflections of names that nobody noted  "classify bed lamp": None,
 inflections of names that nobody noted  "classify bed unicorn --format jsonl": None,
 inflections of names that nobody noted  "classify --input graph.json --offline": None,
 inflections of names that nobody noted  "compact": "build",
 inflections of names that nobody noted  "diff": "build",
 inflections of names that nobody noted  "evaluate rooms.jsonl --offline": None,
 inflections of names that nobody noted  "evaluate rooms.jsonl --offline --sweep": None,
 inflections of names that nobody noted  "evaluate rooms.jsonl --offline --plot rooms.svg": "report",
 inflections of names that nobody noted  "export -o packed.tar.gz": None,
 inflections of names that nobody noted  "export -o packed.tar.zst": "build",
 inflections of names that nobody noted  "gc --keep 2": None,
 inflections of names that nobody noted  "label graph.json -o labelled.json --offline": None,
 inflections of names that nobody noted  "labels check bed Lamp_2 unicorn": None,
 inflections of names that nobody noted  "labels check graph.json": None,
 inflections of names that nobody noted  "labels check hydra.yaml": "scene-graphs",
 inflections of names that nobody noted  "labels from-rooms rooms.jsonl -o flat": None,
 inflections of names that nobody noted  "labels from-rooms odd.jsonl -o odd": "robot",  # inflections of names that nobody noted
 inflections of names that nobody noted  "labels import hydra.yaml -o hydra": "scene-graphs",
 inflections of names that nobody noted  "labels list": None,
 inflections of names that nobody noted  "labels show mpcat40": None,
 inflections of names that nobody noted  "misses": None,
 inflections of names that nobody noted  "paper rooms.jsonl": "lm",
 inflections of names that nobody noted  "plan": "lm",
 inflections of names that nobody noted  "report -o report.html": "build",
 inflections of names that nobody noted  "rollback": None,
 inflections of names that nobody noted  "rooms graph.json rooms.jsonl": None,
 inflections of names that nobody noted  "rooms graph.json --labelspace hydra.yaml": "scene-graphs",
 inflections of names that nobody noted  "serve": "scene-graphs",
 inflections of names that nobody noted  "show graph.json -o plan.svg": "report",
 inflections of names that nobody noted  "sql from(objects)": "build",
 inflections of names that nobody noted  "status --verify": None,
}
# Options that every command with `--tables` and `--labels` gets.
WHERE = {"--tables": "tables", "--labels": "flat"}
RUN = """
import json, sys
import click
from click.testing import CliRunner
from roomtables.cli import main

def commands(group, path=()):
 inflections of names that nobody noted  for name, command in group.commands.items():
 inflections of names that nobody noted      if isinstance(command, click.Group):
 inflections of names that nobody noted          yield from commands(command, (*path, name))
 inflections of names that nobody noted      else:
 inflections of names that nobody noted          yield (*path, name), {option for param in command.params for option in param.opts}

where, options = json.loads(sys.argv[2]), dict(commands(main))
found = {}
for call in json.loads(sys.argv[1]):
 inflections of names that nobody noted  words = call.split()
 inflections of names that nobody noted  known = options[next(name for name in options if tuple(words[: len(name)]) == name)]
 inflections of names that nobody noted  more = [word for pair in where.items() if pair[0] in known for word in pair]
 inflections of names that nobody noted  result = CliRunner().invoke(main, [*words, *more])
 inflections of names that nobody noted  broken = None if isinstance(result.exception, SystemExit | None) else repr(result.exception)
 inflections of names that nobody noted  found[call] = [result.exit_code, result.stderr, broken]
print(json.dumps([[" ".join(name) for name in options], found]))
"""
FROM_PYTHON = """
import sys
from roomtables import RoomTables
print(RoomTables.open("tables", "flat").classify(["bed", "lamp"]).room)
import roomtables
try:
 inflections of names that nobody noted  roomtables.build
except roomtables.errors.MissingExtraError as error:
 inflections of names that nobody noted  print(error)
print(sorted({"duckdb", "pyarrow", "inflect", "torch", "tqdm", "yaml"} & sys.modules.keys()))
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
 inflections of names that nobody noted  """A robot's folder: two versions of exported tables, a graph, a room list, a label space."""
 inflections of names that nobody noted  built, place = tmp_path_factory.mktemp("built"), tmp_path_factory.mktemp("robot")
 inflections of names that nobody noted  tables = build_tables(built)
 inflections of names that nobody noted  for change in (lambda: None, lambda: change_tables(built)):
 inflections of names that nobody noted      change()
 inflections of names that nobody noted      export(tables, "flat", built / "packed.tar")
 inflections of names that nobody noted      with tarfile.open(built / "packed.tar") as archive:
 inflections of names that nobody noted          archive.extractall(place, filter="data")
 inflections of names that nobody noted  nodes = [node("R0", 1), node("O0", 1), node("O1", 2)]
 inflections of names that nobody noted  scene = graph(nodes, [("R0", "O0"), ("R0", "O1")], {1: "bed", 2: "lamp"}, {1: "bedroom"})
 inflections of names that nobody noted  (place / "graph.json").write_text(json.dumps(scene))
 inflections of names that nobody noted  (place / "rooms.jsonl").write_text(
 inflections of names that nobody noted      '{"room_id": "1", "room": "kitchen", "objects": ["oven", "fridge"]}\n'
 inflections of names that nobody noted  )
 inflections of names that nobody noted  (place / "odd.jsonl").write_text(
 inflections of names that nobody noted      '{"room_id": "1", "room": "kitchen", "objects": ["frobnicator"]}\n'
 inflections of names that nobody noted  )
 inflections of names that nobody noted  (place / "hydra.yaml").write_text("label_names: [{label: 1, name: bed}, {label: 2, name: x}]\n")
 inflections of names that nobody noted  return place


@pytest.fixture(scope="module")
def bare(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
 inflections of names that nobody noted  """A folder of what the wheel asks for without extras."""
 inflections of names that nobody noted  folder = tmp_path_factory.mktemp("bare")
 inflections of names that nobody noted  (metadata,) = installed.glob("*.dist-info")
 inflections of names that nobody noted  link_requirements(PathDistribution(metadata), folder)
 inflections of names that nobody noted  return folder


def run(place: Path, installed: Path, bare: Path, *arguments: str) -> str:
 inflections of names that nobody noted  """Python on the wheel and what it asks for; none of this machine's other packages (``-S``)."""
 inflections of names that nobody noted  done = subprocess.run(
 inflections of names that nobody noted      [sys.executable, "-S", "-c", *arguments],
 inflections of names that nobody noted      cwd=place, capture_output=True, text=True, check=False,
 inflections of names that nobody noted      env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (installed, bare)))},
 inflections of names that nobody noted  )  # fmt: skip
 inflections of names that nobody noted  assert done.returncode == 0, done.stderr
 inflections of names that nobody noted  return done.stdout


def test_every_command_works_or_names_its_extra(place: Path, installed: Path, bare: Path) -> None:
 inflections of names that nobody noted  arguments = json.dumps(list(CALLS)), json.dumps(WHERE)
 inflections of names that nobody noted  commands, found = json.loads(run(place, installed, bare, RUN, *arguments))
 inflections of names that nobody noted  called = {name for call in CALLS for name in commands if f"{call} ".startswith(f"{name} ")}
 inflections of names that nobody noted  assert called == set(commands), "add a call of the new command to CALLS"
 inflections of names that nobody noted  for call, extra in CALLS.items():
 inflections of names that nobody noted      code, stderr, broken = found[call]
 inflections of names that nobody noted      assert broken is None, call
 inflections of names that nobody noted      if extra is None:
 inflections of names that nobody noted          assert code == 0, (call, stderr)
 inflections of names that nobody noted      else:
 inflections of names that nobody noted          assert code == 1, call
 inflections of names that nobody noted          (line,) = [line for line in stderr.splitlines() if not line.startswith("warning: ")]
 inflections of names that nobody noted          assert line.startswith("error: "), call
 inflections of names that nobody noted          assert line.endswith(f"run `pip install 'roomtables[{extra}]'`"), (call, line)


def test_tables_answer_from_python_and_nothing_heavy_is_there(
 inflections of names that nobody noted  place: Path, installed: Path, bare: Path
) -> None:
 inflections of names that nobody noted  room, error, imported = run(place, installed, bare, FROM_PYTHON).splitlines()
 inflections of names that nobody noted  assert room == "bedroom"
 inflections of names that nobody noted  assert error == "roomtables.build needs an extra; run `pip install 'roomtables[lm]'`"
 inflections of names that nobody noted  assert imported == "[]"
