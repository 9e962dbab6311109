"""`labels check`: how much of what a robot calls things is understood."""

import csv
import io
import json

import pytest
from click.testing import CliRunner

from roomtables import build
from roomtables.cli import main
from support import HashScorer, small_space, write_space

ROOMS = """\
{"room_id": "1", "objects": ["chair_1", "chair_1", "Bath_Tub", "flumox"]}
{"room_id": "2", "objects": ["chair_1", "wooden stool", "stooll"]}
"""


@pytest.fixture
def check(tmp_path):
    def run(*args, code=0, stdin=None):
        command = ["labels", "check", "--tables", str(tmp_path), *map(str, args)]
        result = CliRunner().invoke(main, command, input=stdin)
        assert result.exit_code == code, result.output
        return result

    return run


@pytest.fixture
def rooms(tmp_path):
    path = tmp_path / "rooms.jsonl"
    path.write_text(ROOMS, encoding="utf-8")
    return path


def test_each_name_of_a_room_list_once_unknown_ones_first_then_by_how_often(check, rooms):
    found = check(rooms, "--format", "json")
    assert [(r["name"], r["times"], r["object"], r["how"]) for r in json.loads(found.stdout)] == [
        ("flumox", 1, None, None),
        ("stooll", 1, None, None),
        ("chair_1", 3, "chair", "spelling"),
        ("Bath_Tub", 1, "bathtub", "spelling"),
        ("wooden stool", 1, "stool", "compound"),
    ]
    assert "stool" in json.loads(found.stdout)[1]["nearest"]
    assert found.stderr == "3 of 5 names understood, 71.4 % of 7 objects\n"


def test_a_table_ends_with_the_summary(check):
    found = check("couch", "flumox")
    assert found.stdout.splitlines()[-1] == "1 of 2 names understood"
    assert "synonym" in found.stdout


def test_csv_and_standard_input(check):
    found = check("-", "--format", "csv", stdin=ROOMS)
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(found.stdout))}
    assert rows["chair_1"]["object"] == "chair"
    assert rows["flumox"]["object"] == ""


def test_names_of_hydras_object_labels(check, tmp_path):
    pytest.importorskip("yaml")
    path = tmp_path / "space.yaml"
    names = "".join(
        f"  - {{label: {i}, name: {n}}}\n" for i, n in enumerate(["sky", "sofa", "xyz"])
    )
    path.write_text(f"label_names:\n{names}object_labels: [1, 2]\n", encoding="utf-8")
    found = check(path, "--format", "jsonl")
    assert [json.loads(line)["name"] for line in found.stdout.splitlines()] == ["xyz", "sofa"]


def test_published_tables_are_asked_before_the_label_space(check, tmp_path):
    labels = write_space(tmp_path / "labels", small_space())
    build(tables=tmp_path, labels=str(labels), scorer=HashScorer(), k=1)
    by_tables = check("bed", "armchair", "--format", "json")
    assert [row["object"] for row in json.loads(by_tables.stdout)] == [None, "bed"]
    by_space = check("bed", "armchair", "--labels", "household", "--format", "json")
    assert [row["object"] for row in json.loads(by_space.stdout)] == ["armchair", "bed"]


def test_a_file_that_is_not_there_is_told(check):
    found = check("missing.json", code=1)
    assert found.stderr.startswith("error: cannot read missing.json")
