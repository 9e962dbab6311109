"""Evaluations that are kept: what SQL will read of them, and names that are refused."""

import json
import os
from datetime import datetime, timedelta, timezone

import duckdb
import pytest
from click.testing import CliRunner

from roomtables import RoomTables, evaluate
from roomtables.cli import main
from roomtables.rooms import Room
from roomtables.schemas import TABLE_BY_NAME
from roomtables.storage.versions import SpaceFolder
from tiny_tables import build_tables, change_tables

ROOMS = [
    Room("1", ("bed", "lamp"), ("bedroom",)),
    Room("2", ("oven", "fridge"), ("kitchen", "office")),
    Room("3", ("piano",), ("office",)),
]


@pytest.fixture
def folder(tmp_path):
    """Tables that hold the first room's combination alone."""
    log = tmp_path / "log.jsonl"
    log.write_text(json.dumps(ROOMS[0].as_json()))
    return build_tables(tmp_path, str(log))


@pytest.fixture
def rooms_file(tmp_path):
    path = tmp_path / "rooms.jsonl"
    path.write_text("".join(json.dumps(room.as_json()) + "\n" for room in ROOMS))
    return path


def run(folder, *arguments):
    options = ("--tables", folder, "--labels", "flat")
    return CliRunner().invoke(main, [str(argument) for argument in (*arguments, *options)])


def kept(folder, name):
    path = folder / "flat" / "evaluations" / f"{name}.parquet"
    return duckdb.sql(f"from '{path}'")


def test_what_is_kept_is_what_was_predicted(folder, rooms_file):
    found = run(folder, "evaluate", rooms_file, "--offline", "--save", "first")
    assert found.exit_code == 0, found.output
    assert "saved evaluation first: 3 rows in" in found.stderr
    rows = kept(folder, "first")
    columns = TABLE_BY_NAME["evaluations"].columns
    assert rows.columns == [column.name for column in columns]
    assert [str(t) for t in rows.types] == [column.type.upper() for column in columns]
    records = [dict(zip(rows.columns, row, strict=True)) for row in rows.fetchall()]
    tables = RoomTables.open(folder, "flat", offline=True)
    for record, judged in zip(records, evaluate(ROOMS, tables).judged, strict=True):
        assert record["predicted"] == judged.prediction.room
        assert record["probability"] == judged.prediction.probability
        assert record["objects"] == list(judged.prediction.objects)
        assert record["version"] == SpaceFolder(folder, "flat").current().name
        now = datetime.now(timezone.utc).replace(tzinfo=None)
        assert now - timedelta(minutes=5) < record["saved"] <= now
    told = ("room_id", "room", "rule", "source", "answered_by", "backed_off", "predicted")
    assert [tuple(record[name] for name in told) for record in records] == [
        ("1", "bedroom", "query", "proxy", "table", False, "bedroom"),
        ("2", "kitchen", "query", "proxy", "table", True, "kitchen"),
        ("3", "office", "query", "proxy", "none", False, None),
    ]


def test_every_condition_is_kept_and_a_name_may_be_used_again(folder, rooms_file):
    common = ("evaluate", rooms_file, "--offline", "--save", "both")
    assert run(folder, *common).exit_code == 0
    found = run(folder, *common, "--compare", "query:proxy,pooled:proxy", "--format", "json")
    assert "replaced evaluation both: 6 rows" in found.stderr
    assert set(json.loads(found.stdout)) == {"conditions", "paired_tests"}
    counts = kept(folder, "both").aggregate("rule, count(*) as n").order("rule").fetchall()
    assert counts == [("pooled", 3), ("query", 3)]
    assert os.listdir(folder / "flat" / "evaluations") == ["both.parquet"]


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../a", "/a", ".a", "a\nb", "a\x00", "a*",
                                  " a", "a ", "x" * 101])  # fmt: skip
def test_a_name_that_is_no_plain_one_is_refused_before_the_work(folder, rooms_file, name):
    found = run(folder, "evaluate", rooms_file, "--offline", "--save", name)
    assert (found.exit_code, found.stdout) == (1, "")
    assert "--save" in found.stderr
    assert not (folder / "flat" / "evaluations").exists()


def test_a_sweep_is_not_kept(folder, rooms_file):
    assert run(folder, "evaluate", rooms_file, "--sweep", "--save", "a").exit_code == 2


def test_a_folder_behind_a_link_is_not_written(folder, rooms_file, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (folder / "flat" / "evaluations").symlink_to(tmp_path / "elsewhere")
    found = run(folder, "evaluate", rooms_file, "--offline", "--save", "a")
    assert found.exit_code == 1
    assert "symbolic link" in found.stderr
    assert os.listdir(tmp_path / "elsewhere") == []


def test_gc_leaves_evaluations_alone(folder, rooms_file, tmp_path):
    assert run(folder, "evaluate", rooms_file, "--offline", "--save", "kept").exit_code == 0
    evaluated = SpaceFolder(folder, "flat").current().name
    change_tables(tmp_path)
    found = CliRunner().invoke(main, ["gc", "--tables", str(folder), "--keep", "1"])
    assert found.exit_code == 0
    assert evaluated not in [path.name for path in SpaceFolder(folder, "flat").versions()]
    assert kept(folder, "kept").aggregate("count(*)").fetchall() == [(3,)]
