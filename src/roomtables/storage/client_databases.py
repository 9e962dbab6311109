"""DuckDB databases of views and macros, for any client; builds write them anew.

Such a file holds no tables but the misses: its views read the published Parquet files by absolute
paths, so it opens from any working directory. Each that was asked for is noted in ``databases/`` in
the label space's folder, one file a database. A published version comes and goes; whoever changes
what is published calls :func:`write_anew`.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from roomtables.errors import InputError, RoomtablesError, StoreError, first_line, needing
from roomtables.limits import JSON_BYTES, MalformedError, json_value, read_bytes
from roomtables.schemas import literal
from roomtables.storage.files import check_name, listed, refuse_outside, write_aside, writing
from roomtables.storage.joined import JoinedFile
from roomtables.storage.scratch import scratch
from roomtables.storage.spaces import published_labels
from roomtables.storage.versions import SpaceFolder, Version
from roomtables.storage.views import create_views

FOLDER = "databases"
# The oldest that holds comments on macros: the shells of DuckDB 1.2 and later open it.
STORAGE_VERSION = "v1.2.0"
_OWN_TABLES = {"noted_misses"}
_OTHER = "is no database that `roomtables sql --db` wrote; give another name"

log = logging.getLogger(__name__)


class ClientDatabase(NamedTuple):
    """A database for other programs: its file, and the files that it joins with the tables."""

    path: Path
    joined: tuple[JoinedFile, ...] = ()

    @classmethod
    def at(cls, path: Path, joined: Sequence[JoinedFile] = ()) -> ClientDatabase:
        """The database at a path, which is made absolute.

        Raises
        ------
        StoreError
            The path is not text.
        """
        check_name(path)
        return cls(path.resolve(), tuple(joined))

    def write(self, tables: Path, version: Version, verify: bool = False) -> None:
        """Write the file, in one rename; what another program has open stays as it is there.

        Raises
        ------
        StoreError
            A published file is damaged, the database cannot be written, or is open for writing
            somewhere.
        InputError
            Another file is there, or a joined one cannot be read.
        """
        with needing("`sql --db`"):
            import duckdb  # noqa: F401  (says which extra to install)
        if self.path.exists():
            _check_own(self.path)
        with new_database(tables, version, self.joined, verify) as made:
            content = made.read_bytes()
        write_aside(self.path, content)

    def note(self, space: SpaceFolder) -> None:
        """See that builds write it anew.

        Raises
        ------
        StoreError
            The label space's folder cannot be written.
        """
        folder = space.path / FOLDER
        refuse_outside(space.path.parent, space.path, folder)
        with writing(folder):
            folder.mkdir(exist_ok=True)
        joined = {file.name: str(file.path) for file in self.joined}
        place = str(space.path.resolve())
        content = {"database": str(self.path), "with": joined, "tables": place}
        write_aside(self._note(space), json.dumps(content, ensure_ascii=False).encode())

    def forget(self, space: SpaceFolder) -> None:
        """Write it anew no more."""
        self._note(space).unlink(missing_ok=True)

    def _note(self, space: SpaceFolder) -> Path:
        return space.path / FOLDER / f"{hashlib.sha256(bytes(self.path)).hexdigest()[:16]}.json"


@contextmanager
def new_database(
    tables: Path, version: Version, joined: Sequence[JoinedFile] = (), verify: bool = False
) -> Iterator[Path]:
    """A file with all views and macros, in a temporary folder; raises as :func:`create_views`."""
    import duckdb

    from roomtables.storage.database import speaking_plainly, within_memory

    with scratch("sql") as folder:
        file = folder / f"{version.path.parent.name}.duckdb"
        attach = f"attach {literal(file)} as made (storage_version {literal(STORAGE_VERSION)})"
        with speaking_plainly(folder), duckdb.connect(config=within_memory()) as connection:
            connection.execute(attach)
            connection.execute("use made")
            create_views(connection, tables, version, joined, verify)
            connection.execute("use memory")
            connection.execute("detach made")
        yield file


def write_anew(tables: Path) -> None:
    """Write all databases anew that were asked for of any label space of a tables folder.

    One that cannot be written is a warning. One that was removed is forgotten, and so is one that
    was asked for of tables in another place, of which these are a copy.
    """
    for labels in published_labels(tables):
        space = SpaceFolder(tables, labels)
        for database, place in list(_noted(space)):
            try:
                if place != space.path.resolve():
                    log.warning("%s shows %s, and is not written anew", database.path, place)
                    database.forget(space)
                elif database.path.exists():
                    database.write(tables, space.current())
                else:
                    log.warning("%s is gone, and is written anew no more", database.path)
                    database.forget(space)
            except (RoomtablesError, OSError) as error:
                log.warning("%s is not written anew: %s", database.path, first_line(error))


def _noted(space: SpaceFolder) -> Iterator[tuple[ClientDatabase, Path]]:
    """The databases that were asked for, each with the label space's folder that it shows.

    A note that cannot be read is a warning.
    """
    for note in listed(space.path / FOLDER):
        if note.suffix != ".json" or note.name[0] == ".":
            continue
        try:
            value: Any = json_value(read_bytes(note, JSON_BYTES))
            joined = tuple(JoinedFile(name, Path(path)) for name, path in value["with"].items())
            yield ClientDatabase(Path(value["database"]), joined), Path(value["tables"])
        except (OSError, MalformedError, LookupError, AttributeError, TypeError) as error:
            log.warning("%s names no database: %s", note, first_line(error))


def _check_own(path: Path) -> None:
    """Refuse to replace what is not a database of views that this package wrote.

    Raises
    ------
    InputError
        It is another file, or holds tables of somebody's own.
    StoreError
        A program has it open for writing.
    """
    import duckdb

    log_ahead = path.with_name(f"{path.name}.wal")
    if log_ahead.exists():
        raise StoreError(
            f"{log_ahead} holds changes that a program has not written into the database yet; "
            "close it there, or remove this file"
        )
    try:
        with duckdb.connect() as connection:
            connection.execute(f"attach {literal(path)} as found (read_only)")
            tables, marks = (
                connection.execute(query).fetchall()
                for query in (
                    "select table_name from duckdb_tables() where database_name = 'found'",
                    "select 1 from duckdb_views() "
                    "where database_name = 'found' and view_name = 'decision'",
                )
            )
    except duckdb.Error as error:
        if "Could not set lock" in str(error):
            raise StoreError(
                f"{path} is open in another program for writing; close it there, or open it "
                "read-only"
            ) from error
        raise InputError(f"{path} {_OTHER}") from error
    others = {name for (name,) in tables} - _OWN_TABLES
    if others:
        raise InputError(
            f"{path} holds tables of your own ({', '.join(sorted(others))[:100]}), which would be "
            "lost; give another name"
        )
    if not marks:
        raise InputError(f"{path} {_OTHER}")
