"""SQL stages: each ``pipeline/<table>.sql`` is one SELECT that is the table of its name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import duckdb

from roomtables.config import pipeline_folder
from roomtables.errors import StoreError
from roomtables.files import writing
from roomtables.labels import LabelSpace
from roomtables.offline.cache import NO_SCORES, quote
from roomtables.offline.pairs import PairValues
from roomtables.schemas import TABLE_BY_NAME

_SHOWN_ROWS = 3
# Of a large machine; half the memory of a small one. docs/scale.md has what it is enough for.
_MEMORY_BYTES = 4 << 30


def stage_sql(table: str) -> str:
    """The SELECT of a stage."""
    return (pipeline_folder() / f"{table}.sql").read_text(encoding="utf-8")


def connect(workspace: Path) -> duckdb.DuckDBPyConnection:
    """A DuckDB database in a file of its own, so that big joins spill to disk."""
    connection = duckdb.connect(str(workspace / "work.duckdb"))
    connection.execute(f"set temp_directory = {quote(workspace / 'spill')}")
    connection.execute(f"set memory_limit = '{_memory_limit() >> 20} MiB'")
    # Before anything is scored, no sentence has a score.
    connection.execute(f"create view sentence_scores as {NO_SCORES}")
    return connection


def _memory_limit() -> int:
    """Bytes that DuckDB may use before it spills to disk."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(_MEMORY_BYTES, physical // 2)


@contextmanager
def interruptible(folder: Path) -> Iterator[None]:
    """Turn what DuckDB and the file system say into this package's words.

    Raises
    ------
    StoreError
        The disk is full, or a file cannot be written or read.
    KeyboardInterrupt
        A query was interrupted.
    """
    try:
        with writing(folder):
            yield
    except duckdb.InterruptException as error:
        raise KeyboardInterrupt from error
    except (duckdb.IOException, duckdb.OutOfMemoryException, duckdb.FatalException) as error:
        text = str(error).strip().splitlines()[0]
        raise StoreError(
            f"cannot build in {folder}: {text}; free some space or memory, then run "
            "`roomtables build` again: what is scored is kept"
        ) from error


def load_labels_tables(connection: duckdb.DuckDBPyConnection, labels: LabelSpace) -> None:
    """Tables ``objects`` and ``rooms``."""
    _create(connection, "objects")
    connection.executemany(
        "insert into objects values (?, ?, ?)",
        [(number, o.label, o.plural) for number, o in enumerate(labels.objects)],
    )
    _create(connection, "rooms")
    connection.executemany(
        "insert into rooms values (?, ?, ?, ?)",
        [(number, r.label, r.article, r.predicted) for number, r in enumerate(labels.rooms)],
    )


def load_pairs(
    connection: duckdb.DuckDBPyConnection, table: str, column: str, pairs: PairValues | None
) -> None:
    """A table of one number per object and room; empty where there are no pairs."""
    connection.execute(f"create table {table} (object varchar, room varchar, {column} double)")
    if pairs is not None:
        rows = [(*pair, value) for pair, value in sorted(pairs.values.items())]
        connection.executemany(f"insert into {table} values (?, ?, ?)", rows)


def load_parameters(
    connection: duckdb.DuckDBPyConnection, parameters: Mapping[str, object]
) -> None:
    """The one-row table ``parameters`` that SQL stages read their settings from."""
    columns = ", ".join(f"? as {name}" for name in parameters)
    connection.execute(f"create table parameters as select {columns}", list(parameters.values()))


def run_stage(connection: duckdb.DuckDBPyConnection, table: str) -> None:
    """Make a table from its SELECT, a published one with its schema's types."""
    published = TABLE_BY_NAME.get(table)
    columns = "*"
    if published:
        columns = ", ".join(f"{c.name}::{c.type} as {c.name}" for c in published.columns)
    connection.execute(f"create table {table} as select {columns} from (\n{stage_sql(table)}\n)")


def run_checks(connection: duckdb.DuckDBPyConnection) -> None:
    """Run every ``pipeline/checks/*.sql``; each must return no row.

    Raises
    ------
    StoreError
        A check returned rows; the message names the check and shows the first of them.
    """
    for path in sorted((pipeline_folder() / "checks").glob("*.sql")):
        rows = connection.execute(path.read_text(encoding="utf-8")).fetchmany(_SHOWN_ROWS)
        if rows:
            raise StoreError(
                f"check {path.stem} failed, so nothing is published; rows: "
                f"{'; '.join(map(str, rows))}; run `roomtables build --full-refresh`"
            )


def export(connection: duckdb.DuckDBPyConnection, table: str, folder: Path) -> int:
    """Write a table to ``<table>.parquet``, in its own order; returns its number of rows."""
    connection.execute(
        f"copy {table} to {quote(folder / f'{table}.parquet')} "
        "(format parquet, compression zstd, row_group_size 16384)"
    )
    rows = connection.execute(f"select count(*) from {table}").fetchall()
    return int(rows[0][0])


def remove_workspace(folder: Path) -> None:
    """Remove what :func:`connect` put into the folder."""
    for path in folder.glob("work.duckdb*"):
        path.unlink()
    shutil.rmtree(folder / "spill", ignore_errors=True)


def _create(connection: duckdb.DuckDBPyConnection, table: str) -> None:
    columns = ", ".join(f"{c.name} {c.type}" for c in TABLE_BY_NAME[table].columns)
    connection.execute(f"create table {table} ({columns})")
