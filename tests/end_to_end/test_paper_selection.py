"""The objects that the paper's authors picked, from their counts and from GPT-J's scores."""

import json

import pytest

from roomtables import RoomTables, build


@pytest.fixture(scope="module")
def data(shared_data):
    return shared_data / "matterport3d"


@pytest.fixture(scope="module")
def tables(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    build(
        tables=folder,
        counts=data / "mpcat40_room_object_counts.csv",
        scores=data / "mpcat40_gpt_j_mean_log_prob.csv",
        reduction="mean",
        combinations="none",
    )
    return folder


def read(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.parametrize(
    ("source", "column"), [("ground_truth", "ground_truth"), ("proxy", "gpt_j")]
)
def test_all_523_selections_are_the_authors(data, tables, source, column):
    opened = RoomTables.open(tables, source=source, rule="query", offline=True)
    rooms = read(data / "mpcat40_rooms_test.jsonl")
    expected = read(data / "mpcat40_expected_selection.jsonl")
    found = opened.classify_many([room["objects"] for room in rooms])
    same = [list(p.objects) == e[column] for p, e in zip(found, expected, strict=True)]
    assert len(same) == 523
    assert all(same)
