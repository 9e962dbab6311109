"""The paper's tables: published numbers as published, ours as evaluated."""

import json

import pytest
from click.testing import CliRunner

from roomtables import RoomTables, evaluate
from roomtables.cli import main
from roomtables.evaluation.paper import PUBLISHED_ROOMS, reproduce
from roomtables.rooms import Room
from tiny_tables import OBJECTS, build_tables, write_labels
from tiny_tables import ROOMS as LABELS

ROOMS = [Room("1", ("bed",), ("bedroom",)), Room("2", ("oven",), ("kitchen",))]


def test_the_published_rooms_are_1878():
    assert sum(PUBLISHED_ROOMS.values()) == 1878
    assert len(PUBLISHED_ROOMS) == 23
    # Percentages as table 1 prints them.
    shares = {room: round(100 * n / 1878, 2) for room, n in PUBLISHED_ROOMS.items()}
    assert (shares["bathroom"], shares["hallway"], shares["library"]) == (19.44, 17.36, 0.05)


def test_trials_are_evaluations(tmp_path):
    tables = RoomTables.open(build_tables(tmp_path), "flat", offline=True)
    found = reproduce([(tables, ROOMS)])
    by_condition = {(t.rule, t.source): t.evaluation for t in found.trials}
    assert by_condition["query", "ground_truth"] is None  # built without counts
    alone = evaluate(ROOMS, tables.deciding(rule="query", source="proxy"))
    assert by_condition["query", "proxy"].as_json() == alone.as_json()
    assert found.frequencies["flat"] == {"bedroom": 1, "kitchen": 1}


def paper(*arguments):
    return CliRunner().invoke(main, ["paper", *map(str, arguments)])


def test_paper_command_on_real_rooms(matterport, gpt_j_folder, tmp_path):
    common = (
        matterport / "mpcat40_rooms_test.jsonl", "--tables", gpt_j_folder,
        "--counts", matterport / "mpcat40_room_object_counts.csv",
        "--scores", matterport / "mpcat40_gpt_j_mean_log_prob.csv",
    )  # fmt: skip
    text = paper(*common, "--plot", tmp_path / "figure.svg")
    assert text.exit_code == 0, text.output
    assert "58.70 % (" in text.stdout
    assert "49.36 %" in text.stdout
    assert "staircase" in (tmp_path / "figure.svg").read_text()
    found = json.loads(paper(*common, "--format", "json").stdout)
    by_condition = {(row["rule"], row["source"]): row for row in found["table_2"]}
    assert by_condition["pooled", "proxy"]["correct"] == 307
    assert by_condition["query", "proxy"]["published"] == pytest.approx(0.27)
    assert by_condition["query", "proxy"]["accuracy"] is None
    assert {row["room"]: row["mpcat40"] for row in found["table_1"]}["bathroom"] == 103


def one_of_each(folder, name, right):
    """ROOMS and its options; of ten beds and ten ovens ``right`` are counted where they belong."""
    folder.mkdir()
    rooms, counts, scores = (folder / file for file in ("rooms.jsonl", "counts.csv", "scores.csv"))
    rooms.write_text("".join(json.dumps(room.as_json()) + "\n" for room in ROOMS))
    counts.write_text(
        f"object,room,count\nbed,bedroom,{right}\nbed,kitchen,{10 - right}\n"
        f"oven,kitchen,{right}\noven,bedroom,{10 - right}\n"
    )
    fits = {("bed", "bedroom"), ("oven", "kitchen")}
    lines = [f"{o},{r},{-1 if (o, r) in fits else -5}\n" for o in OBJECTS for r in LABELS]
    scores.write_text("object,room,log_prob\n" + "".join(lines))
    labels = write_labels(folder).rename(folder / name)
    return rooms, "--labels", labels, "--counts", counts, "--scores", scores


def test_paper_command_builds_what_is_not_there(tmp_path):
    """Two lists of rooms, whose counts say opposite things: no column takes another's."""
    found = paper(
        *one_of_each(tmp_path / "1", "one", 9), *one_of_each(tmp_path / "2", "two", 1),
        "--tables", tmp_path / "tables", "--format", "json",
    )  # fmt: skip
    assert found.exit_code == 0, found.output
    accuracy = {
        (row["labels"], row["source"]): row["accuracy"]
        for row in json.loads(found.stdout)["table_2"]
        if row["rule"] == "pooled"
    }
    assert accuracy == {
        ("one", "ground_truth"): 1, ("one", "proxy"): 1,
        ("two", "ground_truth"): 0, ("two", "proxy"): 1,
    }  # fmt: skip


def test_paper_command_wants_one_of_each_per_list(tmp_path):
    (tmp_path / "rooms.jsonl").write_text('{"room_id": "1", "room": "kitchen", "objects": ["bed"]}')
    rooms = tmp_path / "rooms.jsonl"
    assert paper(rooms, rooms, "--labels", "mpcat40").exit_code == 2
    lost = paper(rooms, "--counts", tmp_path / "none.csv", "--tables", tmp_path / "t")
    assert (lost.exit_code, lost.stdout) == (1, "")
