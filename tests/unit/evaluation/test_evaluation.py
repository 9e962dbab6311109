"""Judging, comparing and sweeping, on tables that a few lines of arithmetic scored."""

import csv
import io
import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from roomtables import RoomTables, evaluate
from roomtables.cli import main
from roomtables.errors import InputError, StoreError
from roomtables.evaluation.comparison import compare, parse_conditions
from roomtables.evaluation.sweeping import EVIDENCE_POWERS, PRIOR_WEIGHTS, sweep
from roomtables.rooms import Room
from tiny_tables import build_tables

ROOMS = [
    Room("1", ("bed", "lamp"), ("bedroom",)),
    Room("2", ("oven", "fridge"), ("kitchen",)),
    Room("3", ("chair",), ("kitchen", "office")),
    Room("4", ("stove",), ("office",)),
    Room("5", ("piano",), ("bedroom",)),
    Room("6", (), ("bedroom",)),
    Room("7", ("bed",), ("stable",)),
    Room("8", ("bed",), ()),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build_tables(tmp_path_factory.mktemp("evaluation"))


@pytest.fixture(scope="module")
def tables(folder):
    return RoomTables.open(folder, "flat", offline=True)


def test_base_json_keys_are_the_contract(tables):
    found = evaluate(ROOMS, tables)
    assert list(found.as_json()) == [
        "rooms", "correct", "accuracy", "macro_accuracy", "rule", "source", "per_room",
        "confusion", "baselines", "answered_by", "backed_off", "unanswered", "top_3_accuracy",
        "skipped",
    ]  # fmt: skip
    assert [*found.as_json(), "statistics"] == list(found.as_json(statistics=True))
    assert found.rooms == 5
    assert found.skipped == {
        "no objects": 1, "no true label": 1, "true label is not a candidate": 1,
    }  # fmt: skip
    assert found.as_json()["unanswered"] == 1
    assert found.as_json()["per_room"]["bedroom"] == {
        "rooms": 2, "correct": 1, "accuracy": 0.5, "unanswered": 1, "backed_off": 0,
    }  # fmt: skip
    # The unanswered room of a piano is wrong, and its probability no part of the calibration.
    assert not found.judged[4].correct
    assert sum(b.rooms for b in found.reliability()) == 4
    assert max(p.coverage for p in found.risk_coverage()) == pytest.approx(4 / 5)


def test_rooms_whose_labels_no_space_has_are_an_error_that_counts_them(tables):
    with pytest.raises(InputError, match="not a candidate: 2"):
        evaluate([Room("1", ("bed",), ("stable",)), Room("2", ("bed",), ("barn",))], tables)


def test_top_three_of_three_candidates_is_everything_answered(tables):
    assert evaluate(ROOMS, tables).top_3_accuracy == pytest.approx(4 / 5)


def test_a_comparison_judges_the_same_rooms(tables):
    found = compare(ROOMS, tables, parse_conditions("query:proxy,pooled:proxy"))
    assert [e.condition for e in found.evaluations] == ["query:proxy", "pooled:proxy"]
    single = evaluate(ROOMS, tables.deciding(rule="pooled"))
    assert found.evaluations[1].as_json() == single.as_json()
    (test,) = found.paired_tests()
    a, b = (e.outcomes for e in found.evaluations)
    assert (test.only_first, test.only_second) == (np.sum(a & ~b), np.sum(~a & b))
    assert test.difference == pytest.approx(a.mean() - b.mean())


@pytest.mark.parametrize("text", ["pooled", "best:proxy", "pooled:guess", "", "pooled:proxy,"])
def test_a_condition_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="RULE:SOURCE"):
        parse_conditions(text)


def test_a_source_that_the_tables_lack_is_refused(tables):
    with pytest.raises(StoreError, match="--counts"):
        compare(ROOMS, tables, [("pooled", "ground_truth")])


def test_a_sweep_is_the_evaluations_of_its_settings(tables):
    found = sweep(ROOMS, tables)
    assert {p.reduction for p in found.points} == {"sum"}
    grid = [p for p in found.points if p.rule == "pooled" and p.k is None]
    assert len(grid) == len(PRIOR_WEIGHTS) * len(EVIDENCE_POWERS)
    for point in grid:
        settings = {"prior_weight": point.prior_weight, "evidence_power": point.evidence_power}
        alone = evaluate(ROOMS, tables.deciding(rule="pooled", **settings))
        assert (point.correct, point.accuracy) == (alone.correct, alone.accuracy)
    asked = {p.k: p.correct for p in found.points if p.rule == "query"}
    assert asked[3] == evaluate(ROOMS, tables.deciding(rule="query")).correct
    assert set(asked) == {1, 2, 3}


def test_a_sweep_says_what_it_cannot_vary(tmp_path):
    tables = RoomTables.open(build_tables(tmp_path, "none"), "flat", offline=True)
    found = sweep(ROOMS, tables)
    assert not [p for p in found.points if p.rule != "pooled"]
    assert any("combinations" in note for note in found.notes)
    assert any("`roomtables build --reduction mean`" in note for note in found.notes)


def held_for(tmp_path, rooms, **options):
    """Tables that hold what some rooms need, and nothing else."""
    log = tmp_path / "held.jsonl"
    log.write_text("".join(json.dumps(room.as_json()) + "\n" for room in rooms))
    return RoomTables.open(build_tables(tmp_path, str(log)), "flat", offline=True, **options)


def test_a_k_that_is_not_held_is_not_varied_and_said(tmp_path):
    rooms = [*ROOMS[:2], ROOMS[4]]  # of two objects each, and one of nothing known
    found = sweep(rooms, held_for(tmp_path, rooms))
    asked = {p.k: p for p in found.points if p.rule == "query"}
    assert set(asked) == {2, 3}  # of k = 1 no combination is held
    assert [p.unanswered for p in asked.values()] == [1, 1]
    assert {p.k for p in found.points if p.rule == "calibrated"} == {2, 3}
    assert {p.k for p in found.points if p.rule == "pooled"} == {None, 1, 2, 3}
    assert found.as_json()["not_held"] == [
        {"source": "proxy", "k": 1, "lacking": 2, "rooms": 3}
    ]  # fmt: skip
    (line,) = found.not_held
    assert "2 of 3 rooms at k = 1" in line
    assert f"{line}; run `roomtables build --combinations all`" in found.notes[0]


def test_unanswered_rooms_are_counted_by_the_reason(tmp_path):
    tables = held_for(tmp_path, ROOMS[:1], backoff=False)
    found = evaluate(ROOMS, tables)
    assert found.unanswered == {
        "no table holds its combination": 3, "no known object": 1,
    }  # fmt: skip
    assert found.backed_off == 0
    backed = evaluate(ROOMS, tables.deciding(backoff=True))
    assert (backed.unanswered, backed.backed_off) == ({"no known object": 1}, 3)
    assert sum(row["backed_off"] for row in backed.per_room().values()) == 3
    unsure = evaluate(ROOMS, tables.deciding(backoff=True, min_probability=1.0))
    assert unsure.unanswered["the answer is too unsure"] > 0


@pytest.fixture
def rooms_file(tmp_path):
    path = tmp_path / "rooms.jsonl"
    path.write_text("".join(json.dumps(room.as_json()) + "\n" for room in ROOMS))
    return path


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_evaluate_command(folder, rooms_file, tmp_path):
    common = ("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--offline")
    plain = json.loads(run(*common, "--format", "json").stdout)
    assert "statistics" not in plain
    assert plain["rooms"] == 5
    assert "95 % interval" in run(*common).stdout
    chart = tmp_path / "rooms.svg"
    compared = run(*common, "--compare", "query:proxy,calibrated:proxy", "--plot", chart)
    assert "McNemar" in compared.stdout
    assert "bedroom" in chart.read_text()
    calibration = tmp_path / "calibration.png"
    found = run(*common, "--format", "json", "--compare", "pooled:proxy,query:proxy",
                "--plot-calibration", calibration)  # fmt: skip
    assert set(json.loads(found.stdout)) == {"conditions", "paired_tests"}
    assert calibration.read_bytes()[1:4] == b"PNG"


def test_sweep_command_draws(folder, rooms_file, tmp_path):
    common = ("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--offline")
    for suffix in ("svg", "png"):
        path = tmp_path / f"sweep.{suffix}"
        found = run(*common, "--sweep", "--plot", path)
        assert found.exit_code == 0, found.output
        assert path.stat().st_size > 1000
    assert "not varied: k above 3" in found.stdout
    drawn = (tmp_path / "sweep.svg").read_text()
    assert "query, proxy" in drawn
    assert "calibrated, proxy, λ" in drawn
    assert "pooled, proxy, λ 0.5" in drawn
    assert run(*common, "--sweep", "--compare", "query:proxy").exit_code == 2


def test_a_picture_of_no_format_is_refused_before_the_work(folder, rooms_file, tmp_path):
    found = run("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--plot", "a.pdf")
    assert (found.exit_code, found.stdout) == (1, "")
    assert ".png or .svg" in found.stderr


def test_a_picture_is_the_same_bytes_twice(folder, rooms_file, tmp_path):
    common = ("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--offline", "--plot")
    paths = [tmp_path / "one.svg", tmp_path / "two.svg"]
    for path in paths:
        assert run(*common, path).exit_code == 0
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_evaluations_as_csv_have_fractions_and_what_is_unanswered(folder, rooms_file):
    common = ("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--offline",
              "--format", "csv")  # fmt: skip
    rooms = list(csv.DictReader(io.StringIO(run(*common).stdout)))
    assert list(rooms[0]) == ["room", "rooms", "correct", "accuracy", "unanswered", "backed_off"]
    assert [row["unanswered"] for row in rooms if row["room"] == "bedroom"] == ["1"]
    found = run(*common, "--compare", "query:proxy,pooled:proxy").stdout
    conditions = list(csv.DictReader(io.StringIO(found)))
    assert [row["rule"] for row in conditions] == ["query", "pooled"]
    assert float(conditions[0]["accuracy"]) == int(conditions[0]["correct"]) / 5
    swept = run(*common, "--sweep")
    points = list(csv.DictReader(io.StringIO(swept.stdout)))
    assert {row["unanswered"] for row in points} == {"1"}
    assert "not varied: k above 3" in swept.stderr


def test_text_writes_an_accuracy_one_way(folder, rooms_file):
    common = ("evaluate", rooms_file, "--tables", folder, "--labels", "flat", "--offline")
    for more in ((), ("--compare", "query:proxy,pooled:proxy"), ("--sweep",)):
        text = run(*common, *more).stdout
        assert re.search(r"\d\d\.\d %", text)
        assert not re.search(r"\d%", text)


def test_a_sweeps_picture_says_what_is_not_held(tmp_path, rooms_file):
    held_for(tmp_path, ROOMS[:2])
    common = ("evaluate", rooms_file, "--tables", tmp_path / "tables", "--labels", "flat")
    picture = tmp_path / "sweep.svg"
    found = run(*common, "--offline", "--sweep", "--plot", picture)
    assert found.exit_code == 0, found.output
    assert "not varied: rules query and calibrated, source proxy" in found.stdout
    drawn = picture.read_text()
    assert "not drawn: rules query and calibrated, source proxy" in drawn
    assert "counted as wrong: up to 1 of 5 rooms unanswered" in drawn
    rooms = tmp_path / "rooms.svg"
    assert run(*common, "--offline", "--no-backoff", "--plot", rooms).exit_code == 0
    assert "unanswered" in rooms.read_text()
