"""Names and messages from anywhere, on their way to a terminal, to JSON and to a spreadsheet."""

import csv
import io
import json
import logging
import os
import subprocess
import sys
from decimal import Decimal

import pytest
from click.testing import CliRunner

from roomtables.cli import main
from roomtables.cli.common import Warnings, render
from roomtables.cli.printing import LogFormatter, csv_cell, in_one_line, printable

TITLE = "\x1b]0;pwned\x07"  # sets a terminal's title
UNSAFE = (
    [chr(code) for code in (*range(0x20), *range(0x7F, 0xA0))]
    + [chr(code) for code in (0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))]
    + ["\ud800", "\udcff", "\udfff"]
)
NAME = f"bed{TITLE}\x9b2J\u202e\udcff"


def is_safe(text):
    return not any(character in text for character in UNSAFE if character != "\n")


def test_what_steers_a_terminal_is_escaped():
    assert in_one_line("".join(UNSAFE)).isascii()
    assert in_one_line(TITLE) == r"\x1b]0;pwned\x07"
    assert in_one_line("a\u202eb\x9bc\udcffd\ne") == r"a\u202eb\x9bc\udcffd\ne"
    assert printable("a\nb\tc") == "a\nb\\tc"


@pytest.mark.parametrize("name", ["Küche", "寝室", "غرفة", "🛏 bed", "l'évier", "50 %", "a\\b"])
def test_names_in_any_script_stay_as_they_are(name):
    assert printable(name) == in_one_line(name) == csv_cell(name) == name


@pytest.mark.parametrize("format_", ["table", "csv", "json", "jsonl"])
def test_rows_are_printed_safely(format_):
    rows = [{"room_id": NAME, f"n{TITLE}": [NAME, "x\ny"], "p": -0.5}]
    text = render(rows, format_)
    assert is_safe(text)
    text.encode()
    if format_ in ("json", "jsonl"):  # a program gets the name as it was
        found = json.loads(text)
        assert (found[0] if format_ == "json" else found) == rows[0]
    else:
        assert r"\x1b]0;pwned\x07" in text


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "=cmd|'x'!A0"])
def test_a_spreadsheet_takes_no_cell_for_a_formula(text):
    rows = [{"room": text, "objects": [text], "n": -1, "x": Decimal("-0.25"), text: None}]
    header, cells = csv.reader(io.StringIO(render(rows, "csv")))
    assert [cells[0][0], cells[1][0], header[4][0]] == ["'", "'", "'"]
    assert cells[2:] == ["-1", "-0.25", ""]  # numbers are numbers
    assert "'" not in render([{"room": "a=b", "objects": ["a", "-b"]}], "csv")


def test_warnings_and_log_lines_are_printed_safely(capsys):
    Warnings()(f"room {NAME}\nis odd")
    said = capsys.readouterr().err
    assert is_safe(said)
    assert said.count("\n") == 1
    record = logging.LogRecord("x", logging.WARNING, "x", 1, "room %s\nis odd", (NAME,), None)
    line = LogFormatter().format(record)
    assert is_safe(line)
    assert "\n" not in line


def run(*args, stdin=None):
    return CliRunner().invoke(main, [str(arg) for arg in args], input=stdin)


def test_an_error_names_a_file_safely(tmp_path):
    for path in (tmp_path / f"{TITLE}.jsonl", f"\u202e{TITLE}"):
        found = run("rooms", path)
        assert found.exit_code == 1
        assert is_safe(found.stderr)
        assert found.stderr.startswith("error: ")
    found = run("gc", "--keep", TITLE)
    assert found.exit_code == 2
    assert is_safe(found.stderr)


def _strings(value):
    """Every string inside parsed JSON, keys too."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, dict):
        return [s for pair in value.items() for part in pair for s in _strings(part)]
    return [s for part in value for s in _strings(part)] if isinstance(value, list) else []


def test_room_ids_and_labels_of_others_are_printed_safely(tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text(json.dumps({"room_id": NAME[:-1], "room": TITLE, "objects": ["=1+1"]}))
    for format_ in ("jsonl", "json", "table", "csv", "nested"):
        found = run("rooms", rooms, "--format", format_)
        assert (found.exit_code, is_safe(found.stdout)) == (0, True), found.output
    for format_ in ("json", "nested"):  # what is parsed is the name as it was
        text = run("rooms", rooms, "--format", format_).stdout
        assert NAME[:-1] in _strings(json.loads(text))
    assert ",'=1+1" in run("rooms", rooms, "--format", "csv").stdout
    folder = tmp_path / "space"
    assert run("labels", "from-rooms", rooms, "-o", folder).exit_code == 0
    # What the package itself reads back holds names as they are.
    assert "\n=1+1," in (folder / "objects.csv").read_text()
    for format_ in ("csv", "table"):
        found = run("labels", "show", folder, "--format", format_)
        assert (found.exit_code, is_safe(found.stdout)) == (0, True), found.output
    assert "object,'=1+1," in run("labels", "show", folder, "--format", "csv").stdout


@pytest.mark.parametrize("locale", ["C", "C.UTF-8"])
def test_an_argument_that_is_no_text_is_refused(tmp_path, locale):
    command = [sys.executable, "-m", "roomtables", "classify", "--tables", str(tmp_path), b"\xff"]
    environment = os.environ | {"LC_ALL": locale, "PYTHONIOENCODING": "utf-8"}
    found = subprocess.run(command, capture_output=True, env=environment)
    assert (found.returncode, found.stdout) == (1, b"")
    assert found.stderr == rb"error: argument \udcff is not UTF-8 text; give it in UTF-8" + b"\n"


def test_a_file_whose_name_is_no_text_is_read(tmp_path):
    rooms = tmp_path / os.fsdecode(b"caf\xe9.jsonl")
    rooms.write_text('{"room_id": "1", "objects": ["bed"]}')
    found = run("rooms", rooms)
    assert (found.exit_code, json.loads(found.stdout)["objects"]) == (0, ["bed"])
    rooms.write_text("{")
    found = run("rooms", rooms)
    assert found.exit_code == 1
    assert r"caf\udce9.jsonl" in found.stderr
