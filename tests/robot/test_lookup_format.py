"""The reader in docs/lookup-format.md, in C++, gives the answers that Python gives."""

from __future__ import annotations

import json
import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from robot_tables import publish
from roomtables import RoomTables
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel
from roomtables.storage.lookup import ARRAYS
from support import HashScorer

PAGE = (Path(__file__).parents[2] / "docs" / "lookup-format.md").read_text(encoding="utf-8")
(READER,) = re.findall(r"```cpp\n(.*?)```", PAGE, re.DOTALL)
OBJECTS = (
    "bed", "canapé", 'so-called "bench"', "back\\slash", "a, b: [c] {d}", "lamp", "oven", "sink",
    "towel",
)  # fmt: skip
SPACE = LabelSpace(
    "made",
    tuple(ObjectLabel(name, f"{name}s", (f"small {name}",)) for name in OBJECTS),
    (
        RoomLabel("attic", "an", predicted=False),
        RoomLabel("bath/room", "a"),
        RoomLabel("chambre à coucher", "a"),
        RoomLabel("kitchen", "a"),
        RoomLabel("office", "an"),
        RoomLabel("zoo", "a", predicted=False),
    ),
)
COUNTS = {("bed", "chambre à coucher"): 7.0, ("oven", "kitchen"): 2.0, ("lamp", "zoo"): 3.0}
NAMES = [*OBJECTS, *(f"small {name}" for name in OBJECTS), "unicorn"]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's program, compiled."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no g++ here to compile the page's reader with")
    folder = tmp_path_factory.mktemp("reader")
    (folder / "label_rooms.cpp").write_text(READER, encoding="utf-8")
    warnings = ["-Wall", "-Wextra", "-Werror", "-pedantic"]
    command = [compiler, "-std=c++17", "-O1", *warnings, "-o", "label_rooms", "label_rooms.cpp"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "label_rooms"


def test_the_reader_is_short_and_needs_the_standard_library_alone() -> None:
    assert READER.count("\n") <= 100
    assert set(re.findall(r"#include (\S)", READER)) == {"<"}


@pytest.mark.parametrize("k", [1, 3, 5])
@pytest.mark.parametrize("smoothing", [None, 0.0])
def test_the_reader_answers_as_python_does(
    reader: Path, tmp_path: Path, k: int, smoothing: float | None
) -> None:
    rng = random.Random(k)
    rooms = [rng.choices(NAMES, k=rng.randrange(8)) for _ in range(200)]
    held = {frozenset(rng.sample(OBJECTS, rng.randint(1, k))) for _ in range(60)}
    version = publish(
        tmp_path, SPACE, HashScorer(), counts=COUNTS, held=None if k == 3 else held, k=k,
        smoothing=smoothing, prior_weight=0.7, evidence_power=2.0,
    )  # fmt: skip
    asked = "".join("\t".join(room) + "\n" for room in rooms)
    answered = set()
    for source in ("proxy", "ground_truth"):
        for rule in ("query", "pooled"):
            done = subprocess.run(
                [reader, version.path / "lookup", source, rule],
                input=asked, capture_output=True, text=True, check=True,
            )  # fmt: skip
            tables = RoomTables.open(tmp_path, "made", offline=True, source=source, rule=rule)
            for room, line in zip(rooms, done.stdout.splitlines(), strict=True):
                label, probability = line.split("\t")
                found = tables.classify(room)
                answered.add(label)
                if found.room is None or found.rule != rule:
                    assert label == "-", room
                else:
                    assert label == found.room, room
                    assert float(probability) == pytest.approx(found.probability, rel=1e-5)
    assert answered == {"-", *(room.label for room in SPACE.predicted_rooms)}


def test_the_page_names_every_key_and_array(tmp_path: Path) -> None:
    version = publish(tmp_path, SPACE, HashScorer())
    index = json.loads((version.path / "lookup" / "lookup.json").read_bytes())
    facts = index["sources"]["proxy"]["scores"]
    described = set(re.findall(r"[`\"](\w+)[`\"]", PAGE))
    assert {*index, *ARRAYS, *facts} <= described
