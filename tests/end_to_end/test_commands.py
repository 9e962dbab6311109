"""Every command of the house, what it prints, and what it says of bad input."""

import json
import subprocess
import sys

import click
import pytest

from roomtables.cli import main

KEYS = [
    "room_id", "room", "probability", "probabilities", "objects", "unknown_objects", "rule",
    "source", "answered_by", "read_as",
]  # fmt: skip


def commands(group=main, path=()):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


@pytest.mark.parametrize(("path", "command"), list(commands()), ids=lambda v: str(v))
def test_every_command_has_help_with_an_example(shell, path, command):
    text = shell(*path, "--help")
    assert "Example:" in text
    assert f"roomtables {' '.join(path)}" in text
    assert shell(*path, "-h") == text


def test_classify_objects(shell, published):
    text = shell(
        "classify", "toilet", "Sinks", "--tables", published, "--offline", "--rule", "query"
    )
    header, _, row = text.splitlines()
    assert header.split()[:2] == ["room", "probability"]
    assert "table" in row


def test_classify_json_lines_obey_the_contract(shell, published):
    rooms = [
        {"room_id": "a", "objects": ["bed", "lamp"]},
        {"room_id": "empty", "objects": []},
        {
            "room_id": "odd",
            "objects": ["zorgblat", "a" * 5000, "'; drop", "🛁", "a, and b"],
        },
        {"room_id": "crowd", "objects": [f"thing {n}" for n in range(10_000)] + ["bed"]},
    ]
    stdin = "\n".join(map(json.dumps, rooms))
    found = shell.lines(
        "classify", "--input", "-", "--format", "jsonl", "--tables", published, "--offline",
        "--rule", "query", stdin=stdin,
    )  # fmt: skip
    assert [row["room_id"] for row in found] == ["a", "empty", "odd", "crowd"]
    for row in found:
        assert list(row)[: len(KEYS)] == KEYS
    first, empty, odd, crowd = found
    assert first["answered_by"] == "table"
    assert first["probability"] == first["probabilities"][first["room"]]
    assert sum(first["probabilities"].values()) == pytest.approx(1)
    assert len(first["probabilities"]) == 23
    assert set(first["objects"]) == {"bed", "lighting"}
    assert (empty["room"], empty["answered_by"]) == (None, "none")
    assert odd["unknown_objects"] == rooms[2]["objects"]
    assert len(crowd["unknown_objects"]) == 10_000
    assert crowd["objects"] == ["bed"]


def test_candidates_are_restricted(shell, published):
    (row,) = shell.lines(
        "classify", "bed", "--tables", published, "--offline", "--rooms", "Office, corridor",
        "--format", "jsonl",
    )  # fmt: skip
    assert set(row["probabilities"]) == {"office", "hallway"}


def test_evaluate_counts_as_the_contract_says(shell, published, tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    lines = [
        {"room_id": "1", "room": "bedroom;kitchen", "objects": ["bed"]},
        {"room_id": "2", "room": "bedroom", "objects": ["bed"]},
        {"room_id": "3", "room": "kitchen", "objects": ["ghost"]},
        {"room_id": "4", "room": "moon", "objects": ["bed"]},
        {"room_id": "5", "room": "kitchen", "objects": []},
        {"room_id": "6", "objects": ["bed"]},
    ]
    rooms.write_text("\n".join(map(json.dumps, lines)))
    found = json.loads(
        shell("evaluate", rooms, "--tables", published, "--offline", "--rule", "query",
              "--rooms", "bedroom,kitchen", "--format", "json")
    )  # fmt: skip
    assert found["rooms"] == 3
    assert found["accuracy"] == pytest.approx(found["correct"] / 3)
    assert set(found["per_room"]) == {"bedroom", "kitchen"}
    assert found["per_room"]["bedroom"]["rooms"] == 2
    assert {"room": "kitchen", "predicted": None, "rooms": 1} in found["confusion"]
    assert found["baselines"] == {"uniform": 0.5, "majority": pytest.approx(2 / 3)}
    assert found["answered_by"] == {"table": 2, "none": 1}
    assert sum(found["skipped"].values()) == 3


def test_status(shell, published):
    found = json.loads(shell("status", "--tables", published, "--format", "json"))
    assert found["labels"] == "mpcat40"
    assert (found["objects"], found["rooms"]) == (35, 27)
    assert found["combinations"] == 35 + 595
    assert found["sources"] == ["proxy"]
    assert found["scorer_id"] == "hash@1"


def test_sql_reads_every_table(shell, published):
    text = shell(
        "sql", "select object, entropy_nats from entropy where source='proxy' order by 2 limit 5",
        "--tables", published,
    )  # fmt: skip
    assert len(text.splitlines()) == 7
    for view in ("objects", "rooms", "cooccurrence", "room_bias", "query_scores"):
        shell("sql", f"select * from {view} limit 1", "--tables", published)
    rows = json.loads(
        shell("sql", "select sum(p_room) as p from query_scores_long group by objects limit 3",
              "--tables", published, "--format", "json")
    )  # fmt: skip
    assert [row["p"] for row in rows] == [pytest.approx(1)] * 3


@pytest.mark.parametrize(
    "query",
    [
        "selct 1",
        "create table x as select 1",
        "copy objects to 'stolen.csv'",
        "select * from read_csv('/etc/passwd')",
        "explain analyze copy objects to 'stolen.csv'",
        "select 1; select 2",
        "set enable_external_access = true",
        "attach 'x.db'",
        "",
    ],
)
def test_sql_that_is_wrong_or_would_write(shell, published, query):
    assert "SQL" in shell("sql", query, "--tables", published, code=1)


def test_labels_from_rooms_builds(shell, tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text(
        '{"room_id": "1", "room": "attic;barn", "objects": ["Hay_bale", "hay bale"]}\n'
    )
    text = shell("labels", "from-rooms", rooms, "-o", tmp_path / "farm")
    assert "1 objects, 2 rooms" in text
    assert "an attic" in shell("labels", "show", tmp_path / "farm")
    assert "holds a label space already" in shell(
        "labels", "from-rooms", rooms, "-o", tmp_path / "farm", code=1
    )


def test_labels_list(shell):
    rows = json.loads(shell("labels", "list", "--format", "json"))
    assert [row["labels"] for row in rows] == ["household", "mpcat40", "nyuclass"]


def test_results_go_to_a_file(shell, published, tmp_path):
    path = tmp_path / "out.csv"
    assert shell("status", "--tables", published, "-o", path) == ""
    assert "hash@1" in path.read_text()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"room_id": "a", "objects": []}\n{', "line 2: invalid JSON"),
        ('{"room_id": "a", "objects": "bed"}', "line 1: `objects` must be a list of strings"),
        ('{"room_id": "a", "objects": [3]}', "line 1: `objects` must be a list of strings"),
    ],
)
def test_malformed_rooms_are_named(shell, published, tmp_path, text, said):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text(text)
    out = tmp_path / "out.jsonl"
    line = shell(
        "classify", "--input", rooms, "--tables", published, "--offline", "-o", out,
        "--format", "jsonl", code=1,
    )  # fmt: skip
    assert said in line
    assert str(rooms) in line
    assert not out.exists()


def test_tables_that_are_not_there(shell, tmp_path, published):
    line = shell("classify", "bed", "--tables", tmp_path / "nowhere", code=1)
    assert "roomtables build" in line
    line = shell("classify", "bed", "--tables", published, "--labels", "nyuclass", code=1)
    assert "there are tables for mpcat40" in line


def test_a_source_that_was_not_built(shell, published):
    line = shell("classify", "bed", "--tables", published, "--source", "ground_truth", code=1)
    assert "--counts" in line


def test_wrong_usage_exits_2(shell):
    shell("classify", code=2)
    shell("classify", "bed", "--rule", "guess", code=2)


def test_the_module_runs():
    run = subprocess.run(
        [sys.executable, "-m", "roomtables", "labels", "list"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "mpcat40" in run.stdout
