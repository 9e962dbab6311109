"""The command that explores tables in SQL: one query, a prompt, or a terminal program."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.printing import echo
from roomtables.errors import InputError, MissingExtraError
from roomtables.schemas import SCORES
from roomtables.storage.files import held
from roomtables.storage.scratch import scratch
from roomtables.storage.spaces import find_space
from roomtables.storage.versions import Version
from roomtables.storage.views import connect, guide, select

_PROMPT, _MORE = "roomtables> ", "       ...> "
_HELP = "end a query with ;   .tables lists what there is   .quit or Ctrl-D leaves"
_LEAVE = {".quit", ".exit", "quit", "exit"}


@click.command("sql")
@click.argument("query", required=False)
@tables_option
@labels_option
@click.option("--ui", is_flag=True, help="Open the tables in harlequin, a terminal program.")
@format_option()
@output_option
def sql_command(
    query: str | None, tables: Path, labels: str | None, ui: bool, format_: str, output: Path | None
) -> None:
    """Ask the published tables in SQL; every table is a view, nothing can be written.

    Without a QUERY, a prompt (or, from a pipe, the queries on standard input).

    \b
    Example:
      roomtables sql "select object, entropy_nats from entropy order by 2 limit 5"
      roomtables sql "from p_room_given(['bed', 'lamp'])"
      roomtables sql
    """
    if ui and (query or output):
        raise click.UsageError("--ui takes no QUERY and no -o")
    version = find_space(tables, labels).current()

    click.get_current_context().with_resource(held(version.path, *(tables / SCORES).glob("*")))
    if ui:
        _harlequin(tables, version)
        return
    connection = connect(tables, version)
    if query is not None:
        emit(_answer(connection, query, format_), output)
    else:
        _interact(connection, format_, output)


def _answer(connection: Any, query: str, format_: str) -> str:
    columns, rows = select(connection, query)
    return render([dict(zip(columns, row, strict=True)) for row in rows], format_, columns)


def _interact(connection: Any, format_: str, output: Path | None) -> None:
    """Read queries until the end; at a terminal an error is shown and the prompt comes back."""
    terminal = sys.stdin.isatty()
    if terminal:
        with suppress(ImportError):
            import readline  # noqa: F401  (arrow keys and history for input())
        echo(_HELP)
    answers: list[str] = []
    query = ""
    while (line := _read(terminal, query)) is not None:
        if not query and line.strip() in _LEAVE:
            break
        if not query and line.strip() == ".tables":
            echo(render(guide(connection), "table"), nl=False)
            continue
        query = f"{query}{line}\n" if line.strip() or query else ""
        if query.rstrip().endswith(";"):
            answers.append(_answer_at_prompt(connection, query, format_, terminal))
            query = ""
    if query.strip():
        answers.append(_answer_at_prompt(connection, query, format_, terminal))
    if output is not None:
        emit("".join(answers), output)
    elif not terminal:
        emit("".join(answers))


def _read(terminal: bool, query: str) -> str | None:
    """The next line, or ``None`` at the end."""
    try:
        return input((_MORE if query else _PROMPT) if terminal else "")
    except EOFError:
        return None


def _answer_at_prompt(connection: Any, query: str, format_: str, terminal: bool) -> str:
    try:
        text = _answer(connection, query, format_)
    except InputError as error:
        if not terminal:
            raise
        echo(f"error: {error}", err=True)
        return ""
    if terminal:
        echo(text, nl=False)
    return text


def _harlequin(tables: Path, version: Version) -> None:
    """Hand the views to harlequin in a database file of their own, read-only."""
    if find_spec("harlequin") is None:
        raise MissingExtraError("`sql --ui`", "ui")
    with scratch("sql") as folder:
        database = folder / f"{version.path.parent.name}.duckdb"
        connect(tables, version, database).close()
        subprocess.run(
            [sys.executable, "-m", "harlequin", "--read-only", str(database)], check=True
        )
