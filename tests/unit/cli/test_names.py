"""What commands say of names, and of rooms that they could not decide by the rule asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from roomtables import RoomTables
from roomtables.cli import main
from roomtables.cli.names import NameReport
from tiny_tables import FitScorer, build_tables


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("names")
    log = root / "log.jsonl"
    log.write_text('{"room_id": "1", "objects": ["bed", "lamp"]}\n')
    return build_tables(root, str(log))


def run(folder: Path, command: str, *arguments: object, stdin: str | None = None) -> Result:
    options = ("--tables", folder, "--labels", "flat", "--offline")
    every = [command, *map(str, (*arguments, *options))]
    result = CliRunner().invoke(main, every, input=stdin, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


def test_a_room_of_unknown_names_says_why_it_has_no_answer(folder: Path) -> None:
    result = run(folder, "classify", "lmp", "snk")
    assert "no known object" in result.stdout
    assert result.stderr == 'unknown to label space flat: "lmp" (lamp?), "snk"\n'


def test_names_that_only_the_model_knows_are_told_with_the_nearest_known_ones(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = RoomTables.open(folder, "flat", scorer=FitScorer())
    answer = tables.classify(["lmp", "bed", "gizmo", "gizmo"])
    assert (answer.answered_by, answer.unknown_objects) == ("lm", ())
    report = NameReport.of(tables)
    report.take(answer)
    report.print()
    assert capsys.readouterr().err == (
        'not in label space flat, so the model was asked: "gizmo" 2 times, "lmp" (lamp?)\n'
    )


def test_names_read_otherwise_are_shown_in_every_format(folder: Path) -> None:
    given = ("old stove", "Bed_2", "lamps", "lamp")
    table = run(folder, "classify", *given)
    assert "old stove = oven, Bed_2 = bed, lamps = lamp" in table.stdout
    assert table.stderr == "read as: old stove = oven\n"
    assert "read_as" not in run(folder, "classify", "bed").stdout
    csv = run(folder, "classify", *given, "--format", "csv")
    assert csv.stdout.splitlines()[0].endswith(",read_as")
    expected = {"old stove": "oven", "Bed_2": "bed", "lamps": "lamp"}
    for format_ in ("json", "jsonl"):
        found = json.loads(run(folder, "classify", *given, "--format", format_).stdout)
        assert (found[0] if format_ == "json" else found)["read_as"] == expected
    assert json.loads(run(folder, "classify", "bed", "--format", "jsonl").stdout)["read_as"] == {}


def test_unknown_names_of_many_rooms_are_counted(folder: Path) -> None:
    rooms = [{"room_id": str(n), "objects": ["bed", "gizmo", f"thing\x1b{n}"]} for n in range(20)]
    stdin = "".join(json.dumps(room) + "\n" for room in rooms)
    said = run(folder, "classify", "--input", "-", "--format", "jsonl", stdin=stdin).stderr
    assert said.startswith('unknown to label space flat: "gizmo" 20 times, "thing\\x1b0"')
    assert said.endswith(", … (21 in all)\n")


def test_what_the_tables_lack_is_backed_off_unless_forbidden(folder: Path) -> None:
    options = ("oven", "fridge", "--format", "jsonl")
    found = json.loads(run(folder, "classify", *options).stdout)
    assert (found["room"], found["rule"], found["answered_by"]) == ("kitchen", "pooled", "table")
    found = json.loads(run(folder, "classify", *options, "--no-backoff").stdout)
    assert (found["room"], found["rule"], found["answered_by"]) == (None, "query", "none")
    table = run(folder, "classify", "oven", "fridge", "--no-backoff").stdout
    assert "not in the tables, and no model to ask" in table


def test_evaluate_says_how_many_were_backed_off_and_which_names_are_unknown(
    folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "rooms.jsonl"
    rooms = [["bed", "lamp"], ["oven", "fridge", "lmp"]]
    lines = [{"room_id": str(at), "room": "office", "objects": o} for at, o in enumerate(rooms)]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    result = run(folder, "evaluate", path)
    assert "backed off to rule pooled: 1\n" in result.stdout
    assert 'unknown to label space flat: "lmp" (lamp?)' in result.stderr
    assert "pooled: 0\n" in run(folder, "evaluate", path, "--no-backoff").stdout


@pytest.mark.parametrize("format_", ["jsonl", "nested", "csv"])
def test_rooms_tells_of_names_that_the_default_label_space_does_not_know(
    tmp_path: Path, format_: str
) -> None:
    path = tmp_path / "rooms.jsonl"
    path.write_text('{"room_id": "1", "objects": ["couch", "toilte", "Chair_2"]}\n')
    result = CliRunner().invoke(main, ["rooms", str(path), "--format", format_])
    assert result.exit_code == 0
    assert "toilte" in result.stdout
    assert result.stderr.startswith('unknown to label space household: "toilte" (toilet')
    assert result.stderr.count("\n") == 1
