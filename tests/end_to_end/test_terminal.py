"""What a person sees at a terminal of 80 or 120 columns, and what a pipe gets."""

from __future__ import annotations

import json
import re

import pytest

from terminal import at_terminal
from tiny_tables import write_labels

NAMES = {
    "classify": {"room_id", "room", "reason", "probability", "objects", "unknown_objects", "rule",
                 "source", "answered_by", "read_as"},
    "compare": {"condition", "rooms", "correct", "accuracy", "95 % interval", "macro", "top 3",
                "calibration error", "unanswered", "backed off"},
    "sweep": {"reduction", "source", "rule", "k", "λ", "γ", "rooms", "correct", "accuracy",
              "unanswered"},
    "status": {"what", "value"},
    "labels": {"kind", "label", "in_a_sentence", "synonyms", "predicted"},
}  # fmt: skip


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    path = tmp_path_factory.mktemp("terminal") / "rooms.jsonl"
    lines = [
        {"room_id": "R(0)", "room": "bathroom", "objects": ["toilet", "sink"]},
        {"room_id": "R(1)", "room": "bedroom", "objects": ["bed", "wooden_lamp_3", "Couches"]},
        {"room_id": "R(2)", "room": "office", "objects": ["toilt", "snk", "gizmo of gizmos"]},
    ]  # fmt: skip
    path.write_text("\n".join(map(json.dumps, lines)))
    return path


@pytest.fixture(scope="module")
def commands(published, rooms):
    tables = ("--tables", published, "--labels", "mpcat40", "--offline", "--rule", "query")
    compared = "query:proxy,calibrated:proxy,pooled:proxy"
    return {
        "classify": ("classify", "--input", rooms, *tables),
        "compare": ("evaluate", rooms, "--compare", compared, *tables),
        "sweep": ("evaluate", rooms, "--sweep", *tables),
        "status": ("status", "--tables", published),
        "labels": ("labels", "show", "nyuclass"),
    }


def table_lines(text):
    """The lines of tables: those above and below a rule of dashes, up to an empty line."""
    blocks = [block.splitlines() for block in text.split("\n\n")]
    return [line for block in blocks if any("---" in line for line in block) for line in block
            if not line.startswith("not varied")]  # fmt: skip


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("name", NAMES)
def test_tables_fit_the_terminal_and_no_name_is_broken(commands, name, columns):
    shown = at_terminal(columns, *commands[name])
    assert shown.code == 0, shown
    lines = table_lines(shown.terminal)
    assert len(lines) > 3
    assert max(map(len, lines)) <= columns
    found = [part for part in re.split(r"\s{2,}", lines[0].strip()) if part]
    assert set(found) <= NAMES[name]
    assert found[0] == re.split(r"\s{2,}", shown.terminal.strip())[0] or name != "classify"


def test_a_room_without_an_answer_and_names_that_nobody_knows(commands):
    shown = at_terminal(80, *commands["classify"])
    (row,) = [line for line in shown.terminal.splitlines() if line.startswith("R(2)")]
    assert row.split()[1] == "–"
    assert "no known" in row
    assert '"toilt" (toilet?), "snk" (sink?)' in shown.stderr


def test_a_pipe_and_a_file_get_every_column_in_one_line_per_row(shell, commands, tmp_path):
    piped = shell(*commands["classify"])
    assert len(piped.splitlines()) == 2 + 3
    assert {"rule", "source", "answered_by", "read_as"} <= set(piped.splitlines()[0].split())
    file = tmp_path / "out.txt"
    shown = at_terminal(80, *commands["classify"], "-o", file)
    assert shown.terminal == ""
    assert file.read_text() == piped


def test_progress_bars_say_what_is_scored_and_stay_legible(tmp_path):
    labels = write_labels(tmp_path)
    arguments = ("build", "--labels", labels, "--tables", tmp_path / "t", "--combinations", "all")
    shown = at_terminal(80, *arguments, all_of_it=True)
    assert shown.code == 0, shown
    bars = [line for line in re.split(r"[\r\n]+", shown.terminal) if "|" in line]
    assert all(len(bar) <= 80 for bar in bars)
    assert all(re.search(r"%\|.{16}\|", bar) for bar in bars)
    stages = dict.fromkeys(bar.split(":")[0] for bar in bars)
    assert list(stages) == ["single-object sentences", "query sentences"]
