"""The DuckDB database that a build works in: its tables, made by name and handed on by value."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from roomtables.schemas import Column, identifier, literal
from roomtables.storage.database import connect, speaking_plainly

# Databases: of the tables that were made, and, in memory, of what one SELECT may see of them.
_MADE, _HANDED = "work", "handed"
_ARROW_TYPES = {
    "varchar": pa.string(),
    "varchar[]": pa.list_(pa.string()),
    "integer": pa.int32(),
    "ubigint": pa.uint64(),
    "double": pa.float64(),
    "boolean": pa.bool_(),
}


class WorkTable(NamedTuple):
    """A table or view of a workspace, under the name that a query says."""

    name: str

    def __str__(self) -> str:
        return f"{_MADE}.{identifier(self.name)}"


class Workspace:
    """A database in a file of its own, so that big joins spill to disk.

    Whoever makes a table gets a :class:`WorkTable` for it; queries name no table that they were
    not handed.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.connection = connect(folder / f"{_MADE}.duckdb", folder / "spill")

    def table(self, name: str, query: str, parameters: Sequence[object] = ()) -> WorkTable:
        """Make or replace a table from a SELECT."""
        made = WorkTable(name)
        self.connection.execute(f"create or replace table {made} as {query}", parameters)
        return made

    def view(self, name: str, query: str) -> WorkTable:
        """Make or replace a view, for what is too large to hold twice."""
        made = WorkTable(name)
        self.connection.execute(f"create or replace view {made} as {query}")
        return made

    def select(self, name: str, query: str, columns: str, handed: Iterable[WorkTable]) -> WorkTable:
        """Make a table of the ``columns`` of a SELECT that sees the tables it is handed, only."""
        made = WorkTable(name)
        self.connection.execute(f"attach ':memory:' as {_HANDED}")
        try:
            for table in handed:
                view = f"{_HANDED}.{identifier(table.name)}"
                self.connection.execute(f"create view {view} as from {table}")
            self.connection.execute(f"use {_HANDED}")
            self.connection.execute(
                f"create or replace table {made} as select {columns} from (\n{query}\n)"
            )
        finally:
            self.connection.execute(f"use {_MADE}")
            self.connection.execute(f"detach {_HANDED}")
        return made

    def load(self, name: str, columns: Sequence[Column], rows: Mapping[str, Any]) -> WorkTable:
        """Make or replace a table from Python lists or arrays, one per column."""
        with self._arriving(columns, rows):
            return self.table(name, "from arriving")

    def append(self, table: WorkTable, columns: Sequence[Column], rows: Mapping[str, Any]) -> None:
        """Add rows to a table, given as one list or array per column."""
        with self._arriving(columns, rows):
            self.connection.execute(f"insert into {table} from arriving")

    @contextmanager
    def _arriving(self, columns: Sequence[Column], rows: Mapping[str, Any]) -> Iterator[None]:
        """Rows as the view ``arriving``."""
        arrays = [pa.array(rows[c.name], _ARROW_TYPES[c.type]) for c in columns]
        self.connection.register("arriving", pa.table(arrays, [c.name for c in columns]))
        try:
            yield
        finally:
            self.connection.unregister("arriving")

    def count(self, table: WorkTable) -> int:
        """Rows of a table."""
        return int(self.rows(f"select count(*) from {table}")[0][0])

    def rows(self, query: str, parameters: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        """All rows of a query."""
        return self.connection.execute(query, parameters).fetchall()

    def export(self, table: WorkTable, folder: Path) -> None:
        """Write a table to ``<table>.parquet``, in its own order."""
        self.connection.execute(
            f"copy {table} to {literal(folder / f'{table.name}.parquet')} "
            "(format parquet, compression zstd, row_group_size 16384)"
        )

    def close(self) -> None:
        """Close the database and remove its files."""
        self.connection.close()
        for path in self._folder.glob(f"{_MADE}.duckdb*"):
            path.unlink()
        shutil.rmtree(self._folder / "spill", ignore_errors=True)


@contextmanager
def workspace(folder: Path) -> Iterator[Workspace]:
    """A workspace in a folder; its files are gone at the end. Raises as `speaking_plainly`."""
    with speaking_plainly(folder):
        opened = Workspace(folder)
        try:
            yield opened
        finally:
            opened.close()
