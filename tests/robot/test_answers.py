"""What a robot asks of its tables, on whatever Python it has: nothing here needs an extra."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from plain_decision import PlainDecision
from robot_tables import publish
from roomtables import RoomTables
from roomtables.cli import main
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from scene_builders import graph, node
from support import HashScorer

# With its plurals written, as in a published lookup: nothing is derived.
SPACE = LabelSpace(
    "robot",
    tuple(
        ObjectLabel(label, plural, synonyms)
        for label, plural, synonyms in (
            ("bed", "beds", ()),
            ("chest of drawers", "chests of drawers", ("dresser",)),
            ("lamp", "lamps", ("light",)),
            ("oven", "ovens", ("stove",)),
            ("sink", "sinks", ()),
        )
    ),
    (
        RoomLabel("bathroom", "a"),
        RoomLabel("bedroom", "a"),
        RoomLabel("kitchen", "a"),
        RoomLabel("yard", "a", predicted=False),
    ),
)
COUNTS = {("bed", "bedroom"): 9.0, ("oven", "kitchen"): 4.0, ("lamp", "yard"): 1.0}
NAMES = ["bed", "Beds", "chest_of_drawers", "dresser", " LAMP ", "oven", "stove", "sink", "", "ufo"]


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    publish(folder, SPACE, HashScorer(), counts=COUNTS)
    return folder


@pytest.mark.parametrize("source", ["proxy", "ground_truth"])
@pytest.mark.parametrize("rule", ["query", "calibrated", "pooled"])
@settings(max_examples=15, deadline=None)
@given(rooms=st.lists(st.lists(st.sampled_from(NAMES), max_size=8), max_size=6))
def test_rooms_are_decided_by_the_definitions(
    tables: Path, rule: str, source: str, rooms: list[list[str]]
) -> None:
    opened = RoomTables.open(tables, "robot", offline=True, rule=rule, source=source)
    score = cache(lambda text: HashScorer().score_of(text).log_prob)
    plain = PlainDecision(SPACE, score, COUNTS, rule, source)
    for names, found in zip(rooms, opened.classify_many(rooms), strict=True):
        expected = plain.answer(names)
        assert found.room == expected.room
        assert list(found.objects) == expected.objects
        assert found.probabilities == pytest.approx(expected.probabilities, rel=1e-6)
        assert opened.classify(names).as_json() == found.as_json()


def test_a_combination_that_no_table_holds_is_noted(tmp_path: Path) -> None:
    publish(tmp_path, SPACE, HashScorer(), held={frozenset(["bed"])})
    opened = RoomTables.open(tmp_path, "robot", offline=True)
    assert opened.classify(["bed"]).answered_by == "table"
    opened.classify(["oven", "bed"])
    (miss,) = Misses.read(tmp_path / "robot" / FOLDER).open
    assert (miss.source, set(miss.objects), miss.times_asked) == ("proxy", {"bed", "oven"}, 1)


def test_commands_label_a_scene_graph(tables: Path, tmp_path: Path) -> None:
    nodes = [node("R0", 1), node("O0", 1), node("O1", 2)]
    scene = graph(nodes, [("R0", "O0"), ("R0", "O1")], {1: "bed", 2: "light"}, {1: "bedroom"})
    (tmp_path / "graph.json").write_text(json.dumps(scene))

    def run(*arguments: str) -> str:
        where = ["--tables", str(tables), "--labels", "robot"] * (arguments[0] != "rooms")
        result = CliRunner().invoke(main, [*arguments, *where])
        assert result.exit_code == 0, result.output
        return result.stdout

    graph_file, labelled = str(tmp_path / "graph.json"), tmp_path / "labelled.json"
    (room,) = map(json.loads, run("rooms", graph_file).splitlines())
    assert room["objects"] == ["bed", "light"]
    asked = ("classify", "--input", graph_file, "--offline", "--format", "jsonl")
    answer = json.loads(run(*asked))
    assert answer["objects"] in (["bed", "lamp"], ["lamp", "bed"])
    run("label", graph_file, "--offline", "-o", str(labelled))
    named = [found["attributes"]["name"] for found in json.loads(labelled.read_text())["nodes"]]
    assert answer["room"] in named
    assert json.loads(run("status", "--format", "json"))["objects"] == 5
    assert "bed" in run("classify", "bed", "lamp", "--offline", "--top", "2")
