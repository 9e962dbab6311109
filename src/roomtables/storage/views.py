"""SQL over the published tables: every table a view, nothing to write.

``pipeline/views`` holds further views, ``pipeline/macros`` functions. A view's first comment line
says what it holds; a macro's first two lines say how it is called, and what it returns.
"""

from __future__ import annotations

import re
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

from roomtables.config import pipeline_folder
from roomtables.errors import InputError, needing
from roomtables.schemas import SCORES, TABLE_BY_NAME, VERSION_TABLES, literal, parquet, plain_path
from roomtables.storage.files import listed
from roomtables.storage.misses import FOLDER, Misses
from roomtables.storage.refusals import refusal
from roomtables.storage.versions import Version


def connect(tables: Path, version: Version, database: Path | str = ":memory:") -> Any:
    """A DuckDB connection with a view for every table of the version, and the macros.

    View ``decision`` holds how the version decides: what the macros go by where nothing else is
    said. Files outside the tables folder cannot be read, and settings cannot be changed.
    ``database`` is a new file to hold the views for another program; the tables are not copied.
    """
    with needing("SQL"):
        import duckdb

    from roomtables.storage.database import within_memory

    connection = duckdb.connect(str(database), config=within_memory())
    for name in VERSION_TABLES:
        path = version.path.resolve() / f"{name}.parquet"
        _view(connection, name, f"from {parquet(path)}", TABLE_BY_NAME[name].grain)
    _sentence_scores(connection, tables)
    _misses(connection, version)
    _decision(connection, version)
    for path in _in_order(*_paths("views"), *_paths("macros")):
        text = path.read_text(encoding="utf-8")
        if path.parent.name == "macros":
            connection.execute(text)
        else:
            _view(connection, path.stem, text, _described(text))
    folder = tables.resolve()  # DuckDB asks for it as the pattern, then as the file that it found
    allowed = ", ".join(map(literal, {str(folder), plain_path(folder)}))
    connection.execute(f"set allowed_directories = [{allowed}]")
    connection.execute("set enable_external_access = false")
    connection.execute("set lock_configuration = true")
    return connection


def guide(connection: Any) -> list[dict[str, str]]:
    """Every view and macro, and what it holds: one row per name."""
    views = connection.execute(
        "select view_name, comment from duckdb_views() where not internal order by 1"
    ).fetchall()
    rows = [{"name": name, "holds": comment or ""} for name, comment in views]
    for path in _paths("macros"):
        lines = path.read_text(encoding="utf-8").splitlines()
        call, meaning = (line.removeprefix("-- ").rstrip(":") for line in lines[:2])
        rows.append({"name": call, "holds": meaning})
    return rows


def _view(connection: Any, name: str, query: str, comment: str) -> None:
    connection.execute(f"create view {name} as {query}")
    connection.execute(f"comment on view {name} is {literal(comment)}")


def _described(text: str) -> str:
    return text.splitlines()[0].removeprefix("-- ").rstrip(".")


def _paths(kind: str) -> list[Path]:
    return sorted((pipeline_folder() / kind).glob("*.sql"))


def _in_order(*paths: Path) -> list[Path]:
    """Views and macros, each behind those that it reads."""
    names = {path.stem: path for path in paths}
    reads = {
        path: [names[word] for word in sorted(_words(path) & names.keys() - {path.stem})]
        for path in paths
    }
    return list(TopologicalSorter(reads).static_order())


def _words(path: Path) -> set[str]:
    """The words of a file of SQL, without its comments."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return set(re.findall(r"\w+", " ".join(line for line in lines if not line.startswith("--"))))


def _decision(connection: Any, version: Version) -> None:
    """How the published version decides, from the settings in its manifest."""
    settings = version.manifest.settings
    query = (
        f"select {literal(settings.source)} as source, {literal(settings.rule)} as rule, "
        f"{settings.prior_weight!r}::double as prior_weight, "
        f"{settings.evidence_power!r}::double as evidence_power, {settings.k} as k"
    )
    _view(connection, "decision", query, "one row: how the published version decides")


def _sentence_scores(connection: Any, tables: Path) -> None:
    from roomtables.storage.score_parts import all_parts, live_parts  # brings pyarrow

    folders = [path for path in listed(tables / SCORES) if path.is_dir()]
    parts = [part.path for folder in folders for part in live_parts(all_parts(folder))]
    table = TABLE_BY_NAME["sentence_scores"]
    empty = ", ".join(f"null::{c.type} as {c.name}" for c in table.columns)
    files = [part.resolve() for part in parts]
    held = f"from {parquet(*files)}" if files else f"select {empty} where false"
    _view(connection, table.name, held, table.grain)


def _misses(connection: Any, version: Version) -> None:
    """The misses that no build has taken in."""
    import pyarrow as pa

    types = {"source": pa.string(), "objects": pa.list_(pa.string()), "times_asked": pa.int64()}
    schema = pa.schema([*types.items(), ("last_asked", pa.timestamp("us"))])
    found = Misses.read(version.path.parent / FOLDER).open
    rows = [miss._asdict() | {"last_asked": miss.last_asked.replace(tzinfo=None)} for miss in found]
    connection.register("noted", pa.Table.from_pylist(rows, schema))
    connection.execute("create table noted_misses as select * from noted")
    connection.unregister("noted")
    _view(connection, "misses", "select * from noted_misses", TABLE_BY_NAME["misses"].grain)


def select(connection: Any, query: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Column names and rows of one reading statement.

    Raises
    ------
    InputError
        The query is wrong, is more than one statement, or would write.
    StoreError
        Memory runs out, or a table cannot be read.
    """
    import duckdb

    try:
        statements = connection.extract_statements(query)
        if [statement.type for statement in statements] != [duckdb.StatementType.SELECT]:
            raise InputError("SQL must be one statement that reads: select, from, describe, show")
        result = connection.execute(query)
        return [column[0] for column in result.description], result.fetchall()
    except duckdb.Error as error:
        refused = refusal(error, doing="read")
        if refused is not None:
            raise refused from error
        text = " ".join(str(error).split())
        raise InputError(f'SQL: {text}; `roomtables sql "show tables"` lists the tables') from error
