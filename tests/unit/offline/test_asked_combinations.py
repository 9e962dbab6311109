"""A build takes misses in: after it, the same question is a table hit."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from roomtables import RoomTables, build
from roomtables.labels import LabelSpace
from roomtables.offline.combinations import Asked
from roomtables.storage.miss_log import MissLog
from roomtables.storage.misses import Misses
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

COUNTS = "object,room,count\nbed,bedroom,3\nsink,kitchen,2\nstove,kitchen,5\ntoilet,bathroom,4\n"


@pytest.fixture
def options(tmp_path: Path) -> dict[str, object]:
    log = tmp_path / "rooms.jsonl"
    log.write_text('{"room_id": "1", "objects": ["bed"]}\n', encoding="utf-8")
    counts = tmp_path / "counts.csv"
    counts.write_text(COUNTS, encoding="utf-8")
    labels = str(write_space(tmp_path / "labels", small_space()))
    return {"tables": tmp_path, "labels": labels, "combinations": str(log), "counts": counts}


def held(tables: Path, source: str) -> set[frozenset[str]]:
    opened = RoomTables.open(
        tables, "small", offline=True, source=source, note_misses=False, backoff=False
    )
    names = [o.label for o in opened.lookup.objects]
    every = [set(c) for size in (1, 2, 3) for c in combinations(names, size)]
    return {frozenset(c) for c in every if opened.classify(sorted(c)).answered_by == "table"}


@pytest.mark.parametrize("asked", ["misses", "file", "all"])
def test_after_the_next_build_the_same_question_is_a_hit(
    tmp_path: Path, options: dict[str, object], asked: str
) -> None:
    build(scorer=HashScorer(), **options)
    tables = RoomTables.open(tmp_path, "small", offline=True, backoff=False)
    assert tables.classify(["toilet", "sink"]).answered_by == "none"
    assert tables.classify_many([["sinks", "TOILET"], ["bed"]])[0].answered_by == "none"
    folder = tmp_path / "small" / "misses"
    (miss,) = Misses.read(folder).open
    assert (miss.source, set(miss.objects), miss.times_asked) == ("proxy", {"sink", "toilet"}, 2)
    build(scorer=HashScorer(), **options | ({} if asked == "file" else {"combinations": asked}))
    assert Misses.read(folder).open == ()
    again = RoomTables.open(tmp_path, "small", offline=True, backoff=False)
    assert again.classify(["toilet", "sink"]).answered_by == "table"
    assert again.classify(["bed"]).answered_by == "table"


def test_auto_is_recorded_as_what_it_came_to(tmp_path: Path, options: dict[str, object]) -> None:
    first = build(scorer=HashScorer(), **options | {"combinations": "auto"})
    assert SpaceFolder(tmp_path, "small").current().manifest.settings.combinations == "all"
    again = build(scorer=HashScorer(), **options | {"combinations": "all"})
    assert (again.published, again.version) == (False, first.version)


def test_auto_of_many_sentences_takes_misses_in_and_without_any_publishes_nothing(
    tmp_path: Path, options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("roomtables.offline.combinations.MOST_SENTENCES", 10)
    auto = options | {"combinations": "auto", "counts": None}
    first = build(scorer=HashScorer(), **auto)
    assert SpaceFolder(tmp_path, "small").current().manifest.combinations == {"proxy": 0}
    same = build(scorer=HashScorer(), **auto)
    assert (same.published, same.version) == (False, first.version)
    MissLog(tmp_path / "small" / "misses").note("proxy", [("sink", "stove")])
    assert build(scorer=HashScorer(), **auto).sentences_scored == 3
    assert held(tmp_path, "proxy") == {frozenset(["sink", "stove"])}
    again = build(scorer=HashScorer(), **auto)
    assert (again.published, again.sentences_scored) == (False, 0)


def test_misses_are_added_to_what_is_held_and_scored_alone(
    tmp_path: Path, options: dict[str, object]
) -> None:
    build(scorer=HashScorer(), **options)
    before = {source: held(tmp_path, source) for source in ("proxy", "ground_truth")}
    MissLog(tmp_path / "small" / "misses").note("ground_truth", [("sink", "stove")])
    scorer = HashScorer()
    report = build(scorer=scorer, **options | {"combinations": "misses"})
    assert report.sentences_scored == len(scorer.asked) == 3
    assert held(tmp_path, "proxy") == before["proxy"]
    assert held(tmp_path, "ground_truth") == before["ground_truth"] | {frozenset(["sink", "stove"])}
    again = build(scorer=HashScorer(), **options | {"combinations": "misses"})
    assert (again.published, again.version) == (False, report.version)


def test_a_file_build_keeps_the_misses_of_earlier_nights(
    tmp_path: Path, options: dict[str, object]
) -> None:
    build(scorer=HashScorer(), **options)
    MissLog(tmp_path / "small" / "misses").note("proxy", [("sink", "stove")])
    build(scorer=HashScorer(), **options)
    assert not build(scorer=HashScorer(), **options).published
    build(scorer=HashScorer(), **options, reduction="mean")
    assert held(tmp_path, "proxy") == {frozenset(["bed"]), frozenset(["sink", "stove"])}


def test_misses_of_objects_that_are_no_more_are_passed_over(
    tmp_path: Path, options: dict[str, object]
) -> None:
    build(scorer=HashScorer(), **options)
    MissLog(tmp_path / "small" / "misses").note("proxy", [("anvil", "bed"), ("sink", "bed")])
    build(scorer=HashScorer(), **options | {"combinations": "misses"})
    assert held(tmp_path, "proxy") == {frozenset(["bed"]), frozenset(["sink", "bed"])}
    assert Misses.read(tmp_path / "small" / "misses").open == ()


def test_published_combinations_survive_another_label_order_and_other_entropies(
    tmp_path: Path, options: dict[str, object]
) -> None:
    build(scorer=HashScorer(), **options | {"combinations": "all"})
    space = LabelSpace.named("small", ["anvil", "bed", "sink", "toilet"], ["bathroom", "kitchen"])
    write_space(tmp_path / "labels", space)
    Path(str(options["counts"])).write_text("object,room,count\nbed,kitchen,3\n", encoding="utf-8")
    build(scorer=HashScorer("other@2"), **options | {"combinations": "misses"})
    kept = [set(c) for size in (1, 2, 3) for c in combinations(["bed", "sink", "toilet"], size)]
    for source in ("proxy", "ground_truth"):
        assert held(tmp_path, source) == {frozenset(c) for c in kept}


def test_without_a_published_version_misses_alone_are_built(
    tmp_path: Path, options: dict[str, object]
) -> None:
    (tmp_path / "small").mkdir()
    MissLog(tmp_path / "small" / "misses").note("proxy", [("bed", "sink")])
    build(scorer=HashScorer(), **options | {"combinations": "misses"})
    assert held(tmp_path, "proxy") == {frozenset(["bed", "sink"])}


def test_ranked_takes_the_most_informative_of_a_wider_combination() -> None:
    asked = Asked(by_source={"proxy": np.array([[1, 2, 3], [2, 0, 0], [1, 3, 0]])})
    ranks = [3, 1, 2]  # of objects 1, 2, 3
    assert asked.ranked("proxy", ranks, 2).tolist() == [[1, 0], [1, 2], [2, 3]]
    assert asked.ranked("proxy", ranks, 4).tolist() == [[1, 0, 0, 0], [1, 2, 3, 0], [2, 3, 0, 0]]
    assert asked.ranked("ground_truth", ranks, 2).shape == (0, 2)


def test_the_misses_command_lists_what_no_table_held(
    tmp_path: Path, options: dict[str, object]
) -> None:
    from click.testing import CliRunner

    from roomtables.cli import main
    from roomtables.storage.views import connect, select

    build(scorer=HashScorer(), **options)
    command = ["misses", "--tables", str(tmp_path), "--labels", "small"]
    assert json.loads(CliRunner().invoke(main, [*command, "--format", "json"]).output) == []
    RoomTables.open(tmp_path, "small", offline=True, backoff=False).classify(["sink", "stove"])
    (row,) = json.loads(CliRunner().invoke(main, [*command, "--format", "json"]).output)
    assert set(row) == {"source", "objects", "times_asked", "last_asked"}
    assert (row["source"], set(row["objects"]), row["times_asked"]) == (
        "proxy",
        {"sink", "stove"},
        1,
    )
    table = CliRunner().invoke(main, command)
    assert table.exit_code == 0
    assert "times_asked" in table.output
    version = SpaceFolder(tmp_path, "small").current()
    connection = connect(tmp_path, version)
    columns, rows = select(connection, "select * from misses")
    assert (columns, rows[0][0], rows[0][2]) == (list(row), "proxy", 1)
    missing = CliRunner().invoke(main, ["misses", "--tables", str(tmp_path), "--labels", "nowhere"])
    assert missing.exit_code == 1
    assert "no tables for nowhere" in missing.output


def test_status_says_how_much_is_held_and_what_the_rest_takes(
    tmp_path: Path, options: dict[str, object]
) -> None:
    from click.testing import CliRunner

    from roomtables.cli import main

    build(scorer=HashScorer(), **options)
    command = ["status", "--tables", str(tmp_path), "--labels", "small"]
    found = json.loads(CliRunner().invoke(main, [*command, "--format", "json"]).output)
    assert found["combinations"] == 2
    coverage = found["coverage"]
    assert (coverage["combinations"], coverage["held"]) == (2 * (4 + 6 + 4), 2)
    assert coverage["rest_sentences"] == (28 - 2) * 3
    assert "2 of 28 combinations" in CliRunner().invoke(main, command).output


def test_plan_counts_the_misses(tmp_path: Path, options: dict[str, object]) -> None:
    from roomtables.offline.plan import plan

    build(scorer=HashScorer(), **options)
    MissLog(tmp_path / "small" / "misses").note("proxy", [("sink", "stove")])
    found = plan(scorer=HashScorer(), **options | {"combinations": "misses"})
    assert found.sentences_to_score == 3
    assert found.coverage.held == 3
