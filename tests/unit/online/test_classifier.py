"""Rooms are decided as the definitions say, one at a time or many at once."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plain_decision import PlainDecision
from roomtables import Prediction, RoomTables, build
from roomtables.errors import ConfigError, InputError, StoreError
from roomtables.labels import LabelSpace, RoomLabel
from support import HashScorer, write_space

SPACE = LabelSpace(
    "flat",
    LabelSpace.named(
        "flat", ["bed", "chest of drawers", "lamp", "oven", "sink", "towel"], ["office"]
    ).objects,
    (
        RoomLabel("bathroom", "a"),
        RoomLabel("bedroom", "a"),
        RoomLabel("kitchen", "a"),
        RoomLabel("office", "an"),
        RoomLabel("yard", "a", predicted=False),
    ),
)
COUNTS = {
    ("bed", "bedroom"): 9.0, ("bed", "office"): 1.0, ("oven", "kitchen"): 4.0,
    ("sink", "kitchen"): 3.0, ("sink", "bathroom"): 5.0, ("towel", "bathroom"): 2.0,
    ("lamp", "yard"): 1.0,
}  # fmt: skip
LOGGED = [["bed", "lamp"], ["oven", "sink", "towel"], ["sink"]]
NAMES = [
    "bed", "Beds", "chest_of_drawers", "lamp", " LAMP ", "oven", "sink", "sinks", "towel",
    "towels", "unicorn", "Unicorn", "gizmo", "", "  ", "Bed_12", "ChestOfDrawers", "Gizmo-7",
    "old oil lamp", "towel on the unicorn",
]  # fmt: skip
RULES = ("query", "calibrated", "pooled")
SOURCES = ("proxy", "ground_truth")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Tables of all combinations, and of those that a log of rooms needs."""
    root = tmp_path_factory.mktemp("classifier")
    folder = write_space(root, SPACE)
    counts = root / "counts.csv"
    rows = [f"{o},{r},{n}" for (o, r), n in COUNTS.items()]
    counts.write_text("\n".join(["object,room,count", *rows]) + "\n", encoding="utf-8")
    log = root / "log.jsonl"
    lines = [json.dumps({"room_id": str(n), "objects": o}) for n, o in enumerate(LOGGED)]
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    tables = {"all": root / "all", "logged": root / "logged"}
    for name, asked in (("all", "all"), ("logged", str(log))):
        options = {"labels": str(folder), "counts": counts, "combinations": asked}
        build(tables=tables[name], scorer=HashScorer(), **options)
    return tables


def plain(rule: str, source: str, held: bool = True, **more: object) -> PlainDecision:
    scorer = HashScorer()
    some = None if held else {frozenset(objects) for objects in LOGGED}
    decision = {"rule": rule, "source": source, "combinations": some, **more}
    score = cache(lambda text: scorer.score_of(text).log_prob)
    return PlainDecision(SPACE, score, COUNTS, **decision)  # type: ignore[arg-type]


def check(found: Prediction, decision: PlainDecision, names: Sequence[str]) -> None:
    expected = decision.answer(names)
    assert found.room == expected.room
    assert list(found.objects) == expected.objects
    assert list(found.unknown_objects) == expected.unknown
    assert found.answered_by == expected.answered_by
    assert found.probabilities == pytest.approx(expected.probabilities, rel=1e-6)
    assert (found.rule, found.source) == (expected.rule, decision.source)
    assert found.backed_off == (expected.rule != decision.rule)
    assert found.read_as == expected.read_as


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("held", ["all", "logged"])
@settings(max_examples=12, deadline=None)
@given(
    rooms=st.lists(st.lists(st.sampled_from(NAMES), max_size=12), max_size=6), backoff=st.booleans()
)
def test_one_room_and_many_are_decided_by_the_definitions(
    built: dict[str, Path],
    rule: str,
    source: str,
    held: str,
    rooms: list[list[str]],
    backoff: bool,
) -> None:
    decision = {"rule": rule, "source": source, "backoff": backoff}
    tables = RoomTables.open(built[held], "flat", offline=True, **decision)  # type: ignore[arg-type]
    expected = plain(held=held == "all", **decision)  # type: ignore[arg-type]
    many = tables.classify_many(rooms)
    assert len(many) == len(rooms)
    for names, one, found in zip(rooms, map(tables.classify, rooms), many, strict=True):
        check(one, expected, names)
        assert one.as_json() == found.as_json()
    assert many.rooms == [prediction.room for prediction in many]


@pytest.mark.parametrize("rule", RULES)
@settings(max_examples=10, deadline=None)
@given(rooms=st.lists(st.lists(st.sampled_from(NAMES), max_size=8), max_size=4))
def test_the_model_answers_what_no_table_holds(
    built: dict[str, Path], rule: str, rooms: list[list[str]]
) -> None:
    tables = RoomTables.open(built["logged"], "flat", scorer=HashScorer(), rule=rule)
    for names, found in zip(rooms, tables.classify_many(rooms), strict=True):
        check(found, plain(rule, "proxy", held=False, model=True), names)
        assert tables.classify(names).as_json() == found.as_json()


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("source", SOURCES)
def test_candidates_can_be_restricted(built: dict[str, Path], rule: str, source: str) -> None:
    rooms = ("office", "bathroom")
    tables = RoomTables.open(built["all"], "flat", rule=rule, source=source, rooms=rooms)
    every = [names for size in (1, 3, 4) for names in combinations(NAMES[2:10], size)]
    for names, found in zip(every, tables.classify_many(every), strict=True):
        check(found, plain(rule, source, rooms=rooms), names)
        assert tables.classify(names).as_json() == found.as_json()


def test_misses_of_many_rooms_share_one_pass_of_the_model(built: dict[str, Path]) -> None:
    scorer = HashScorer()
    passes: list[int] = []
    score = scorer.score
    scorer.score = lambda texts: passes.append(len(texts)) or score(texts)  # type: ignore[method-assign,func-returns-value]
    tables = RoomTables.open(built["logged"], "flat", scorer=scorer)
    found = tables.classify_many([["bed", "oven"], ["sink"], ["lamp", "towel"]])
    assert [p.answered_by for p in found] == ["lm", "table", "lm"]
    assert passes == [8]


def test_predictions_are_a_sequence(built: dict[str, Path]) -> None:
    found = RoomTables.open(built["all"], "flat").classify_many([["bed"], [], ["sink"]])
    assert [p.objects for p in found[:2]] == [("bed",), ()]
    assert found[-1].objects == ("sink",)
    assert (found[1].room, found[1].probability, found[1].probabilities) == (None, None, {})
    with pytest.raises(IndexError):
        found[3]
    assert list(RoomTables.open(built["all"], "flat").classify_many([])) == []


def test_what_a_caller_does_with_the_list_later_changes_no_answer(built: dict[str, Path]) -> None:
    rooms = [["bed", "unicorn"]]
    found = RoomTables.open(built["all"], "flat", offline=True).classify_many(rooms)
    rooms[0][:] = ["sink"]
    assert (found[0].objects, found[0].unknown_objects) == (("bed",), ("unicorn",))


@pytest.mark.parametrize("objects", ["bed", [3], [None, "bed"]])
def test_objects_must_be_a_list_of_strings(built: dict[str, Path], objects: object) -> None:
    tables = RoomTables.open(built["all"], "flat", offline=True)
    with pytest.raises(InputError, match="objects must be"):
        tables.classify(objects)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="objects must be"):
        tables.classify_many([["bed"], objects])  # type: ignore[list-item]


def test_wrong_decisions_are_refused(built: dict[str, Path]) -> None:
    tables = RoomTables.open(built["all"], "flat", offline=True)
    with pytest.raises(ConfigError, match="rule"):
        tables.deciding(rule="best")
    with pytest.raises(StoreError, match="hold no source"):
        tables.deciding(source="hearsay")
    with pytest.raises(InputError, match="never predicted"):
        tables.deciding(rooms=("yard",))
    with pytest.raises(InputError, match="no table knows room 'crypt'"):
        tables.deciding(rooms=("crypt",))
    with pytest.raises(InputError, match="'yard' is never predicted"):
        tables.deciding(rooms=("yard", "crypt"))
    with pytest.raises(ConfigError, match="rooms must be names"):
        tables.deciding(rooms=(5,))


def test_a_never_predicted_room_is_refused_beside_one_that_a_model_could_judge(
    built: dict[str, Path],
) -> None:
    tables = RoomTables.open(built["all"], "flat", scorer=HashScorer())
    with pytest.raises(InputError, match="'yard' is never predicted"):
        tables.deciding(rooms=("yard", "sauna"))


def test_one_room_may_be_given_as_text(built: dict[str, Path]) -> None:
    tables = RoomTables.open(built["all"], "flat", offline=True, rooms="kitchen")
    assert [room.label for room in tables.candidates] == ["kitchen"]
    assert [room.label for room in tables.deciding(rooms="office").candidates] == ["office"]


@pytest.mark.parametrize("objects", [[["bed"]], [{"a": 1}], [b"bed"], [None], None, 5, [3.5]])
def test_objects_that_are_no_names_are_refused(built: dict[str, Path], objects: Any) -> None:
    tables = RoomTables.open(built["all"], "flat", offline=True)
    for ask in (tables.classify, lambda given: tables.classify_many([["bed"], given])):
        with pytest.raises(InputError, match="objects must be strings"):
            ask(objects)


def test_threads_share_one(built: dict[str, Path]) -> None:
    scorer = HashScorer()
    tables = RoomTables.open(built["logged"], "flat", scorer=scorer)
    rooms = [list(names) for size in (1, 2, 3) for names in combinations(NAMES[:11], size)]
    expected = [
        RoomTables.open(built["logged"], "flat", scorer=scorer).classify(r).as_json() for r in rooms
    ]
    wrong: list[object] = []

    def work(offset: int) -> None:
        for at in range(len(rooms)):
            place = (at + offset) % len(rooms)
            if tables.classify(rooms[place]).as_json() != expected[place]:
                wrong.append(rooms[place])

    threads = [threading.Thread(target=work, args=(offset,)) for offset in (0, 50, 100, 150)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
