"""The command that explores tables in SQL: one query, a shell, a database for other programs."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    Warnings,
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.printing import echo
from roomtables.errors import MissingExtraError, StoreError, needing
from roomtables.schemas import SCORES, literal
from roomtables.storage.client_databases import ClientDatabase, new_database
from roomtables.storage.files import held
from roomtables.storage.joined import JoinedFile, allowed, parse_joined, prefer_joined
from roomtables.storage.spaces import find_space
from roomtables.storage.versions import SpaceFolder, Version
from roomtables.storage.views import SENTENCE_SCORES, connect, select, verify_scores

# How DuckDB's shell prints each format; `table` is its own.
_MODES = {"table": (), "json": ("-json",), "jsonl": ("-jsonlines",), "csv": ("-csv",)}


def _joined(ctx: click.Context, param: click.Parameter, value: Sequence[str]) -> Any:
    return parse_joined(value)


@click.command("sql")
@click.argument("query", required=False)
@tables_option
@labels_option
@click.option(
    "--db",
    "database",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a DuckDB database of all views and macros; later builds write it anew.",
)
@click.option(
    "--with",
    "joined",
    multiple=True,
    callback=_joined,
    metavar="NAME=FILE",
    help="Join a JSON, JSON lines, CSV or Parquet file, under a name.",
)
@click.option("--ui", is_flag=True, help="Open the tables in harlequin, a terminal program.")
@click.option("--verify", is_flag=True, help="Read and compare every byte of the tables first.")
@format_option()
@output_option
def sql_command(
    query: str | None,
    tables: Path,
    labels: str | None,
    database: Path | None,
    joined: tuple[JoinedFile, ...],
    ui: bool,
    verify: bool,
    format_: str,
    output: Path | None,
) -> None:
    """Ask the published tables in SQL; every table is a view, nothing can be written.

    Without a QUERY, DuckDB's own shell (extra `ui`).

    \b
    Example:
      roomtables sql "from guide"
      roomtables sql "from p_room_given(['bed', 'sink'])"
      roomtables sql --with log=rooms.jsonl "select room_id, len(objects) from log"
      roomtables sql --db rooms.duckdb
      roomtables sql
    """
    _check_options(query, database, ui, output)
    space = find_space(tables, labels)
    version = space.current()
    holding = held(version.path, *space.versions(), *(tables / SCORES).glob("*"))
    click.get_current_context().with_resource(holding)
    # Whoever reads the scores reads them whole, so they are compared whole, and only then.
    if verify or query is None or SENTENCE_SCORES in query.casefold():
        with needing("SQL"):
            verify_scores(tables)
    if database is not None:
        _write_database(ClientDatabase.at(database, joined), tables, space, version, verify)
    elif query is not None:
        columns, rows = select(connect(tables, version, joined, verify), query)
        records = [dict(zip(columns, row, strict=True)) for row in rows]
        emit(render(records, format_, columns), output)
    else:
        program = _harlequin() if ui else _shell(tables, joined, format_)
        with needing("SQL"):
            made = new_database(tables, version, joined, verify)
        with made as file, _leaving_interrupts():
            code = subprocess.run([*program, str(file)]).returncode
        click.get_current_context().exit(min(abs(code), 1))


def _check_options(query: str | None, database: Path | None, ui: bool, output: Path | None) -> None:
    alone = "--db" if database is not None else "--ui" if ui else ""
    if alone and (query is not None or output is not None or (database is not None and ui)):
        raise click.UsageError(f"{alone} takes no QUERY, no -o, and no other of --db and --ui")
    if query is None and output is not None:
        raise click.UsageError("-o needs a QUERY")


def _write_database(
    database: ClientDatabase, tables: Path, space: SpaceFolder, version: Version, verify: bool
) -> None:
    database.write(tables, version, verify)
    try:
        database.note(space)
        anew = "; later builds write it anew"
    except StoreError as error:
        Warnings()(f"later builds do not write {database.path} anew: {error}")
        anew = ""
    echo(f"wrote {database.path}: views of {version.path.resolve()}{anew}")


def _harlequin() -> list[str]:
    """How harlequin is started, but for the database."""
    if find_spec("harlequin") is None:
        raise MissingExtraError("`sql --ui`", "ui")
    return [sys.executable, "-m", "harlequin", "--read-only"]


def _shell(tables: Path, joined: Sequence[JoinedFile], format_: str) -> list[str]:
    """How DuckDB's shell is started, but for the database: it reads the tables and nothing else.

    Its safe mode forbids whatever reaches outside the database, except what was allowed before.
    """
    package = find_spec("duckdb_cli")
    folder = Path(package.origin).parent if package and package.origin else None
    program = shutil.which("duckdb", path=folder) or shutil.which("duckdb")
    if program is None:
        raise MissingExtraError("`sql` without a query, which opens DuckDB's shell,", "ui")
    from roomtables.storage.database import within_memory

    settings = [
        "set timezone = 'UTC'",
        *(f"set {name} = {literal(value)}" for name, value in within_memory().items()),
        *allowed(tables, joined),
        prefer_joined(joined),
        ".safe_mode",
    ]
    commands = [word for setting in settings for word in ("-cmd", setting)]
    return [program, "-readonly", *_MODES[format_], *commands]


@contextmanager
def _leaving_interrupts() -> Iterator[None]:
    """Leave Ctrl-C to the program that is started: there it ends a query, not the session."""
    before = signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
