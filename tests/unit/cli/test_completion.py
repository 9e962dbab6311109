"""What a shell completes, and that `-h` helps everywhere."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from roomtables.cli import main
from roomtables.storage.versions import SpaceFolder
from tiny_tables import build_tables, change_tables


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two versions of label space ``flat`` in ``tables``."""
    folder = tmp_path_factory.mktemp("completion")
    build_tables(folder)
    change_tables(folder)
    return folder


def completed(*words: object) -> list[str]:
    """What the last word may become."""
    *before, last = map(str, words)
    shell = ShellComplete(main, {}, "roomtables", "_ROOMTABLES_COMPLETE")
    return [item.value for item in shell.get_completions(before, last)]


@pytest.mark.parametrize("command", ["classify", "evaluate", "build", "status", "sql", "report"])
def test_label_spaces_built_in_and_published(root: Path, command: str) -> None:
    tables = root / "tables"
    assert completed(command, "--tables", tables, "--labels", "") == [
        "flat", "household", "mpcat40", "nyuclass",
    ]  # fmt: skip
    assert completed(command, "--tables", tables, "--labels", "f") == ["flat"]
    assert completed(command, "--tables", root / "none", "--labels", "m") == ["mpcat40"]


def test_label_spaces_of_other_commands() -> None:
    assert completed("labels", "show", "nyu") == ["nyuclass"]
    assert completed("labels", "import", "x.yaml", "--rooms-of", "house") == ["household"]
    assert completed("paper", "rooms.jsonl", "--labels", "mp") == ["mpcat40"]
    assert completed("rooms", "x.house", "--labels", "mp") == ["mpcat40"]


def test_rules_sources_and_formats() -> None:
    assert completed("classify", "bed", "--rule", "") == ["query", "calibrated", "pooled"]
    assert completed("evaluate", "rooms.jsonl", "--source", "p") == ["proxy"]
    assert completed("status", "--format", "j") == ["json"]


def test_published_versions_newest_first(root: Path) -> None:
    tables = root / "tables"
    names = [path.name for path in reversed(SpaceFolder(tables, "flat").versions())]
    assert len(names) == 2
    assert completed("diff", "--tables", tables, "") == names
    assert completed("diff", "--tables", tables, "--labels", "flat", "000001") == names[1:]
    assert completed("diff", "--tables", tables, "--labels", "none", "") == []
    assert completed("diff", "--tables", root / "none", "") == []


def test_a_shell_is_told_how_to_complete() -> None:
    environment = {"_ROOMTABLES_COMPLETE": "bash_source"}
    found = CliRunner().invoke(main, [], prog_name="roomtables", env=environment)
    assert found.exit_code == 0
    assert "_roomtables_completion" in found.stdout


def test_the_group_itself_has_short_help() -> None:
    assert CliRunner().invoke(main, ["-h"]).stdout == CliRunner().invoke(main, ["--help"]).stdout
    assert "Commands:" in CliRunner().invoke(main, ["labels", "-h"]).stdout
