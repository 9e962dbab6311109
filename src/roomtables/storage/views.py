"""SQL over the published tables: every table a view, nothing to write.

``pipeline/views`` holds further views, ``pipeline/macros`` functions. A view's first comment line
says what it holds; a macro's comment says how it is called, and from the second line on what it
returns. In a database these are the comments on the view and the macro.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from graphlib import TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roomtables.config import pipeline_folder
from roomtables.errors import InputError, first_line, needing
from roomtables.schemas import (
    SCORES,
    TABLE_BY_NAME,
    VERSION_TABLES,
    identifier,
    literal,
    parquet,
)
from roomtables.storage.files import listed
from roomtables.storage.histories import (
    View,
    evaluations_view,
    note_misses,
    open_misses_view,
    published_versions,
    version_views,
)
from roomtables.storage.joined import JoinedFile, allowed, join, prefer_joined
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from roomtables.storage.refusals import refusal
from roomtables.storage.versions import SpaceFolder, Version

if TYPE_CHECKING:
    from roomtables.storage.score_parts import Part

SENTENCE_SCORES = "sentence_scores"
Rows = tuple[list[str], list[tuple[Any, ...]]]

_READS = "SQL must be one statement that reads: select, from, describe, show"
_WITH_ZONE = "WITH TIME ZONE"


def connect(
    tables: Path, version: Version, joined: Sequence[JoinedFile] = (), verify: bool = False
) -> Any:
    """A DuckDB connection with a view for every table of the version, and the macros.

    Files outside the tables folder cannot be read, except those that are joined, and settings
    cannot be changed. Raises as :func:`create_views`.
    """
    with needing("SQL"):
        import duckdb

    from roomtables.storage.database import within_memory

    connection = duckdb.connect(config=within_memory())
    connection.execute("set timezone = 'UTC'")
    create_views(connection, tables, version, joined, verify)
    for setting in (
        prefer_joined(joined),
        *allowed(tables, joined),
        "set enable_external_access = false",
        "set lock_configuration = true",
    ):
        connection.execute(setting)
    return connection


def create_views(
    connection: Any,
    tables: Path,
    version: Version,
    joined: Sequence[JoinedFile] = (),
    verify: bool = False,
) -> None:
    """Create all views and macros in a connection's current database.

    View ``decision`` holds how the version decides: what the macros go by where nothing else is
    said.

    Parameters
    ----------
    connection : of DuckDB
    tables : the tables folder
    version : the published version
    joined : files to create views of, too; in schema ``joined`` where a table has the name
    verify : read and compare every byte of the tables

    Raises
    ------
    StoreError
        A published file is damaged.
    InputError
        A joined file cannot be read, or bears the name of a table that macros read.
    """
    space = SpaceFolder(version.path.parent.parent, version.path.parent.name)
    versions = published_versions(space, version, verify)
    for view in _tables(version, tables):
        _create(connection, view)
    for view in (*version_views(versions, version), evaluations_view(space)):
        _create(connection, view)
    note_misses(connection, Misses.read(space.path / FOLDER))
    _create(connection, open_misses_view())
    _create(connection, _one_column_per_room(connection))
    for path in _in_order(*_paths("views"), *_paths("macros")):
        text = path.read_text(encoding="utf-8")
        if path.parent.name == "macros":
            connection.execute(text)
            kind = "macro table" if "as table\n" in text else "macro"
            holds = " ".join(_comment(text)[1:])
            connection.execute(f"comment on {kind} {path.stem} is {literal(holds)}")
        else:
            _create(connection, View(path.stem, text, _comment(text)[0]))
    join(connection, joined, _words_of_macros())


def _create(connection: Any, view: View) -> None:
    connection.execute(f"create view {view.name} as {view.query}")
    connection.execute(f"comment on view {view.name} is {literal(view.holds)}")


def _comment(text: str) -> list[str]:
    """The comment on top of a file of SQL, by line; the last without its full stop."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("-- "):
            break
        lines.append(line.removeprefix("-- ").rstrip(":"))
    return [line.rstrip(".") for line in lines]


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


def _words_of_macros() -> frozenset[str]:
    return frozenset[str]().union(*map(_words, _paths("macros")))


def _tables(version: Version, tables: Path) -> Iterator[View]:
    for name in VERSION_TABLES:
        path = version.path.resolve() / f"{name}.parquet"
        yield View(name, f"from {parquet(path)}", TABLE_BY_NAME[name].grain)
    yield _sentence_scores(tables)
    settings = version.manifest.settings
    yield View(
        "decision",
        f"select {literal(settings.source)} as source, {literal(settings.rule)} as rule, "
        f"{settings.prior_weight!r}::double as prior_weight, "
        f"{settings.evidence_power!r}::double as evidence_power, {settings.k} as k",
        "one row: how the published version decides",
    )


def verify_scores(tables: Path) -> None:
    """Compare every part of the sentence scores with its name, which is a hash of its content.

    Raises
    ------
    StoreError
        A part is damaged.
    """
    for part in _score_parts(tables):
        part.verify()


def _score_parts(tables: Path) -> list[Part]:
    from roomtables.storage.score_parts import all_parts, live_parts  # brings pyarrow

    folders = [path for path in listed(tables / SCORES) if path.is_dir() and path.name[0] != "."]
    return [part for folder in folders for part in live_parts(all_parts(folder))]


def _sentence_scores(tables: Path) -> View:
    table = TABLE_BY_NAME[SENTENCE_SCORES]
    empty = ", ".join(f"null::{c.type} as {c.name}" for c in table.columns)
    files = [part.path.resolve() for part in _score_parts(tables)]
    held = f"from {parquet(*files)}" if files else f"select {empty} where false"
    return View(table.name, held, table.grain)


def _one_column_per_room(connection: Any) -> View:
    """``p_room_by_object``: p(room | object) with a column per room, named by its label."""
    rooms = connection.execute("select label from rooms order by label").fetchall()
    columns = ", ".join(
        f"max(p_room_given_object) filter (room = {literal(room)}) as {identifier(room)}"
        for (room,) in rooms
    )
    return View(
        "p_room_by_object",
        f"select source, object, {columns} from cooccurrence group by source, object",
        "one row per source, object: p(room | object) with a column per room, named by its label",
    )


def select(connection: Any, query: str) -> Rows:
    """Column names and rows of one reading statement.

    Times with a zone are in UTC.

    Raises
    ------
    InputError
        The query is wrong, is more than one statement, would write, or has a value that Python
        cannot hold.
    StoreError
        Memory runs out, or a table cannot be read.
    """
    import duckdb

    try:
        statements = connection.extract_statements(query)
        if [statement.type for statement in statements] != [duckdb.StatementType.SELECT]:
            raise InputError(_READS)
        # A SELECT can hold a DELETE: `with gone as (delete … returning *) from gone`.
        connection.execute("begin transaction read only")
        try:
            return _fetched(connection.execute(query))
        finally:
            connection.execute("rollback")
    except duckdb.Error as error:
        if "read-only mode" in str(error):
            raise InputError(_READS) from error
        refused = refusal(error, doing="read")
        if refused is not None:
            raise refused from error
        text = " ".join(str(error).split())
        raise InputError(f'SQL: {text}; `roomtables sql "from guide"` lists the tables') from error
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"SQL: {first_line(error)}; cast the column to varchar") from error


def _fetched(result: Any) -> Rows:
    names = [column[0] for column in result.description]
    if not any(_WITH_ZONE in str(column[1]) for column in result.description):
        return names, result.fetchall()
    # For a time with a zone DuckDB wants pytz, which Arrow does not.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that rows are copied once more
        table = result.to_arrow_table()
    return names, list(zip(*(column.to_pylist() for column in table.columns), strict=True))
