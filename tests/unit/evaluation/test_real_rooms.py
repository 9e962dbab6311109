"""The figures that this project stands on, from GPT-J's released table and 523 real rooms."""

import json

import pytest

from roomtables import RoomTables, evaluate
from roomtables.evaluation.sweeping import EVIDENCE_POWERS, sweep


@pytest.fixture(scope="module")
def tables(gpt_j_folder):
    return RoomTables.open(gpt_j_folder, offline=True)


@pytest.fixture(scope="module")
def mean_tables(build_gpt_j):
    return RoomTables.open(build_gpt_j(reduction="mean"), offline=True)


def test_pooled_proxy_at_the_defaults(tables, matterport):
    found = evaluate(matterport / "mpcat40_rooms_test.jsonl", tables.deciding(rule="pooled"))
    assert (found.correct, found.rooms) == (307, 523)
    assert found.as_json()["answered_by"] == {"table": 523}


def test_the_sweep_is_the_known_table(tables, matterport):
    points = sweep(matterport / "mpcat40_rooms_test.jsonl", tables).points
    grid = {
        (p.prior_weight, p.evidence_power): round(100 * p.accuracy, 1)
        for p in points
        if (p.rule, p.source, p.k) == ("pooled", "proxy", None)
    }
    assert (grid[0.0, 0.0], grid[1.0, 0.0]) == (45.5, 47.2)
    assert [grid[weight, 3.0] for weight in (0.0, 0.5, 0.75, 1.0)] == [53.5, 58.7, 57.4, 50.9]
    counted = {
        p.k: round(100 * p.accuracy, 1)
        for p in points
        if p.source == "ground_truth" and p.evidence_power == 3.0
    }
    assert counted.keys() == {None, 1, 2, 3}


def test_a_sweep_does_not_vary_what_has_no_effect_on_counts(tables, matterport):
    points = sweep(matterport / "mpcat40_rooms_test.jsonl", tables).points
    grid = [p for p in points if p.source == "ground_truth" and p.k is None]
    assert [p.evidence_power for p in grid] == list(EVIDENCE_POWERS)
    assert {p.prior_weight for p in grid} == {None}


def test_naive_products_of_the_single_object_scores(tables, matterport):
    """λ = 0 and γ = 0: Σ L over all of a room's objects."""
    rooms = matterport / "mpcat40_rooms_test.jsonl"
    naive = tables.deciding(rule="pooled", prior_weight=0.0, evidence_power=0.0)
    assert round(100 * evaluate(rooms, naive).accuracy, 1) == 45.5
    counts = naive.deciding(source="ground_truth")
    assert round(100 * evaluate(rooms, counts).accuracy, 1) == 49.3


@pytest.mark.parametrize("rule", ["query", "pooled"])
@pytest.mark.parametrize(("source", "name"), [("ground_truth", "ground_truth"), ("proxy", "gpt_j")])
def test_the_selection_of_objects_is_the_authors(matterport, mean_tables, source, name, rule):
    """523 of 523 rooms, with the mean per token that the authors' released code uses."""
    rooms = read(matterport / "mpcat40_rooms_test.jsonl")
    expected = read(matterport / "mpcat40_expected_selection.jsonl")
    opened = mean_tables.deciding(source=source, rule=rule)
    found = opened.classify_many([room["objects"] for room in rooms])
    assert len(rooms) == 523
    assert [list(p.objects) for p in found] == [row[name] for row in expected]


def read(path):
    return [json.loads(line) for line in path.read_text().splitlines()]
