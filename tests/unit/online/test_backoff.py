"""Where no table holds a room's combination and no model may answer, rule pooled decides."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from roomtables import RoomTables, evaluate
from roomtables.errors import InputError
from roomtables.rooms import Room
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from tiny_tables import FitScorer, build_tables

HELD, MISSED = ["bed", "lamp"], ["oven", "fridge", "Chair_7"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("backoff")
    log = root / "log.jsonl"
    log.write_text('{"room_id": "1", "objects": ["bed", "lamp"]}\n')
    return build_tables(root, str(log))


def opened(folder: Path, **options: object) -> RoomTables:
    return RoomTables.open(folder, "flat", **{"note_misses": False, **options})  # type: ignore[arg-type]


@pytest.mark.parametrize("rule", ["query", "calibrated"])
def test_the_answer_is_that_of_rule_pooled(folder: Path, rule: str) -> None:
    tables = opened(folder, offline=True, rule=rule)
    pooled = tables.deciding(rule="pooled").classify(MISSED)
    many = tables.classify_many([MISSED, HELD, MISSED])
    assert many.rooms == [pooled.room, tables.classify(HELD).room, pooled.room]
    for found in (tables.classify(MISSED), many[0], many[2]):
        assert found.as_json() == pooled.as_json()
        assert (found.rule, found.answered_by, found.backed_off) == ("pooled", "table", True)
        assert found.evidence == pooled.evidence
    for found in (tables.classify(HELD), many[1]):
        assert (found.rule, found.backed_off) == (rule, False)


def test_it_can_be_forbidden(folder: Path) -> None:
    tables = opened(folder, offline=True, backoff=False)
    for found in (tables.classify(MISSED), tables.classify_many([MISSED])[0]):
        assert (found.room, found.rule, found.answered_by) == (None, "query", "none")
        assert (found.objects, found.backed_off) == (("chair", "fridge", "oven"), False)
    assert tables.classify_many([MISSED, HELD]).rooms == [None, tables.classify(HELD).room]


def test_nothing_known_stays_unanswered(folder: Path) -> None:
    tables = opened(folder, offline=True)
    many = tables.classify_many([["toilte"], [], MISSED])
    assert many.rooms[:2] == [None, None]
    for found in (tables.classify(["toilte"]), many[0]):
        assert (found.answered_by, found.rule, found.backed_off) == ("none", "query", False)
        assert found.unknown_objects == ("toilte",)


def test_the_minimum_holds_for_the_rule_that_decided(folder: Path) -> None:
    plain = opened(folder, offline=True).classify(MISSED)
    assert plain.probability is not None
    below, above = plain.probability - 1e-6, min(plain.probability + 1e-6, 1.0)
    for least, room in ((below, plain.room), (above, None)):
        tables = opened(folder, offline=True, min_probability=least)
        assert tables.classify(MISSED).room == room
        assert tables.classify_many([MISSED]).rooms == [room]
        assert tables.classify(MISSED).rule == "pooled"


def test_each_miss_is_noted_once(folder: Path) -> None:
    tables = opened(folder, offline=True, note_misses=True)
    many = tables.classify_many([MISSED, HELD, ["toilte"], MISSED])
    assert [found.room for found in many] == many.rooms  # looking at an answer notes nothing
    tables.classify(MISSED)
    (miss,) = Misses.read(folder / "flat" / FOLDER).open
    assert (miss.objects, miss.times_asked) == (("chair", "fridge", "oven"), 3)


def test_a_model_at_hand_answers_instead(folder: Path) -> None:
    scorer = FitScorer()
    tables = opened(folder, scorer=scorer)
    assert tables.classify(MISSED).answered_by == "lm"
    assert [found.backed_off for found in tables.classify_many([MISSED, HELD])] == [False, False]
    assert scorer.calls > 0


@pytest.mark.parametrize("objects", [MISSED, [*MISSED, "toilte"], [*HELD, "toilte"], ["toilte"]])
def test_a_model_that_is_not_there_fails_nothing_and_is_missed_once(
    folder: Path, objects: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    # No model is called as the scorer of these tables is.
    tables, offline = opened(folder), opened(folder, offline=True)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert tables.classify(objects).as_json() == offline.classify(objects).as_json()
            assert tables.classify_many([objects])[0].room == offline.classify(objects).room
    assert len(caplog.records) == 1


def test_candidates_that_no_table_knows_still_need_a_model(folder: Path) -> None:
    with pytest.raises(InputError, match="no table knows room 'crypt'"):
        opened(folder, offline=True, rooms=("crypt", "office"))


def test_an_evaluation_counts_what_was_backed_off(folder: Path) -> None:
    rooms = [
        Room("1", tuple(HELD), ("bedroom",)),
        Room("2", tuple(MISSED), ("kitchen",)),
        Room("3", ("toilte",), ("office",)),
    ]
    found = evaluate(rooms, opened(folder, offline=True)).as_json()
    assert (found["rule"], found["backed_off"]) == ("query", 1)
    assert found["answered_by"] == {"table": 2, "none": 1}
    strict = evaluate(rooms, opened(folder, offline=True, backoff=False)).as_json()
    assert (strict["backed_off"], strict["answered_by"]) == (0, {"table": 1, "none": 2})
