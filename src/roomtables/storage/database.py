"""DuckDB as this package opens it: within the process's memory, with paths read as they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import duckdb

from roomtables.errors import StoreError
from roomtables.memory import MEGABYTE, address_space_limit, available
from roomtables.schemas import literal
from roomtables.storage.refusals import refusal

# Of a large machine; half the memory of a small one. docs/scale.md has what it is enough for.
_MEMORY_BYTES = 4 << 30
# Under `ulimit -v` DuckDB gets a fourth of what is left: it maps more than the memory it counts.
_LIMITED_SHARE = 4
# What DuckDB says, in a RuntimeError, where a signal meets it in a query.
_INTERRUPTED = "Query interrupted"


def connect(database: Path | None = None, spill: Path | None = None) -> duckdb.DuckDBPyConnection:
    """A connection to a database in memory, or to a new file that nobody opens again.

    Parameters
    ----------
    database : the file; its tables are named without a prefix
    spill : the folder for what memory cannot hold

    Raises
    ------
    StoreError
        The file's path holds a backslash.
    """
    if database is not None and "\\" in str(database):
        raise StoreError(
            f"{database.parent}: DuckDB takes the backslash for a slash; use a folder without one"
        )
    connection = duckdb.connect(config=within_memory())
    if spill is not None:
        connection.execute(f"set temp_directory = {literal(spill)}")
    if database is not None:
        # Nothing is to be found again after a crash, so nothing is logged ahead; and DuckDB would
        # look for the log of `a?b/x.duckdb` in the folder `a.wal?b`.
        connection.execute(
            f"attach {literal(database)} as {database.stem} (recovery_mode no_wal_writes)"
        )
        connection.execute(f"use {database.stem}")
        # Nobody opens the file again, so it need not be put in order.
        connection.execute("pragma disable_checkpoint_on_shutdown")
    return connection


def within_memory() -> dict[str, str | bool | int | float | list[str]]:
    """Settings for as much memory and as many threads as this process can afford."""
    if address_space_limit() is None:
        return {"memory_limit": f"{min(_MEMORY_BYTES, available() // 2) // MEGABYTE} MiB"}
    most = min(_MEMORY_BYTES, available() // _LIMITED_SHARE)
    return {"memory_limit": f"{most // MEGABYTE} MiB", "threads": 1}


@contextmanager
def speaking_plainly(folder: Path, doing: str = "write") -> Iterator[None]:
    """Turn what DuckDB and the file system say of a folder into this package's words.

    Raises
    ------
    StoreError
        The disk is full, memory runs out, or a file cannot be written or read.
    KeyboardInterrupt
        A query was interrupted.
    """
    try:
        yield
    except duckdb.InterruptException as error:
        raise KeyboardInterrupt from error
    except RuntimeError as error:
        if str(error) != _INTERRUPTED:
            raise
        raise KeyboardInterrupt from error
    except (duckdb.Error, OSError, MemoryError) as error:
        said = refusal(error, folder, doing)
        if said is None:
            raise
        raise said from error
