"""SQL over the published tables: every table a view, nothing to write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from roomtables.config import pipeline_folder
from roomtables.errors import InputError
from roomtables.parts import SCORES, all_parts, live_parts
from roomtables.schemas import TABLE_BY_NAME, VERSION_TABLES
from roomtables.store import Version


def _literal(path: Path | str) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def connect(tables: Path, version: Version) -> Any:
    """An in-memory DuckDB connection with a view for every table of the version.

    Files outside the tables folder cannot be read, and settings cannot be changed.
    """
    import duckdb

    connection = duckdb.connect()
    for name in VERSION_TABLES:
        path = version.path.resolve() / f"{name}.parquet"
        connection.execute(f"create view {name} as select * from read_parquet({_literal(path)})")
    _sentence_scores(connection, tables)
    for path in sorted((pipeline_folder() / "views").glob("*.sql")):
        connection.execute(f"create view {path.stem} as {path.read_text(encoding='utf-8')}")
    connection.execute(f"set allowed_directories = [{_literal(tables.resolve())}]")
    connection.execute("set enable_external_access = false")
    connection.execute("set lock_configuration = true")
    return connection


def _sentence_scores(connection: Any, tables: Path) -> None:
    folders = sorted(path for path in (tables / SCORES).glob("*") if path.is_dir())
    parts = [part.path for folder in folders for part in live_parts(all_parts(folder))]
    columns = TABLE_BY_NAME["sentence_scores"].columns
    empty = ", ".join(f"null::{c.type} as {c.name}" for c in columns)
    files = ", ".join(_literal(part.resolve()) for part in parts)
    held = f"select * from read_parquet([{files}])" if parts else f"select {empty} where false"
    connection.execute(f"create view sentence_scores as {held}")


def select(connection: Any, query: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Column names and rows of one reading statement.

    Raises
    ------
    InputError
        The query is wrong, is more than one statement, or would write.
    """
    import duckdb

    try:
        statements = connection.extract_statements(query)
        if [statement.type for statement in statements] != [duckdb.StatementType.SELECT]:
            raise InputError("SQL must be one statement that reads: select, from, describe, show")
        result = connection.execute(query)
        return [column[0] for column in result.description], result.fetchall()
    except duckdb.Error as error:
        text = " ".join(str(error).split())
        raise InputError(f'SQL: {text}; `roomtables sql "show tables"` lists the tables') from error
