"""Files that SQL joins with the tables: ``--with log=rooms.jsonl``, also CSV and Parquet."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple

from roomtables.errors import InputError, first_line
from roomtables.schemas import identifier, literal, plain_path

# The schema of files that bear the name of a table.
JOINED = "joined"
# How DuckDB reads a file of each suffix.
_READERS = {
    ".jsonl": "read_json([{0}], format = 'newline_delimited')",
    ".ndjson": "read_json([{0}], format = 'newline_delimited')",
    ".json": "read_json([{0}])",
    ".csv": "read_csv([{0}])",
    ".tsv": "read_csv([{0}])",
    ".parquet": "read_parquet([{0}])",
}
_PACKED = (".gz", ".zst")
_NAME = re.compile(r"[^\W\d]\w{0,62}")


class JoinedFile(NamedTuple):
    """A file, and the name that queries call it by."""

    name: str
    path: Path

    @classmethod
    def parse(cls, text: str) -> JoinedFile:
        """What ``--with`` says: ``NAME=FILE``.

        Raises
        ------
        InputError
            It is not of this form, or there is no such file, or none of a kind that SQL reads.
        """
        name, _, path = text.partition("=")
        if not path or not _NAME.fullmatch(name):
            raise InputError(f"--with: {text!r} is not NAME=FILE, such as log=rooms.jsonl"[:300])
        joined = cls(name, Path(path).resolve())
        if not joined.path.is_file():
            raise InputError(f"--with: there is no file {path}")
        if joined._suffix() not in _READERS:
            raise InputError(f"--with: {path} must be one of *{', *'.join(_READERS)}")
        return joined

    @property
    def query(self) -> str:
        """The SELECT that reads the file, whatever stands in its path."""
        return f"from {_READERS[self._suffix()].format(literal(plain_path(self.path)))}"

    def _suffix(self) -> str:
        suffixes = [suffix.casefold() for suffix in self.path.suffixes]
        if suffixes and suffixes[-1] in _PACKED:
            suffixes.pop()
        return suffixes[-1] if suffixes else ""


def parse_joined(texts: Iterable[str]) -> tuple[JoinedFile, ...]:
    """All that ``--with`` says, each name once.

    Raises
    ------
    InputError
        As :meth:`JoinedFile.parse`, or a name is given twice.
    """
    found = tuple(map(JoinedFile.parse, texts))
    names = [joined.name.casefold() for joined in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--with: {name} is given twice; give each file a name of its own")
    return found


def prefer_joined(joined: Sequence[JoinedFile]) -> str:
    """The statement with which joined files win over tables of the same name."""
    return f"set search_path = {literal(f'{JOINED},main' if joined else 'main')}"


def allowed(tables: Path, joined: Sequence[JoinedFile]) -> tuple[str, str]:
    """The statements that allow reading the tables folder and the joined files."""
    return (
        _setting("allowed_directories", [tables.resolve()]),
        _setting("allowed_paths", [file.path for file in joined]),
    )


def _setting(name: str, paths: Sequence[Path]) -> str:
    # DuckDB asks for a path as the pattern, then as the file that it found.
    both = dict.fromkeys(text for path in paths for text in (str(path), plain_path(path)))
    return f"set {name} = [{', '.join(map(literal, both))}]"


def join(connection: Any, joined: Sequence[JoinedFile], reserved: Set[str]) -> None:
    """A view for each file; in schema ``joined`` where a table has its name.

    Parameters
    ----------
    connection : with all tables in its current database
    joined : the files
    reserved : names of tables that no file may take, since macros read them

    Raises
    ------
    InputError
        A file cannot be read, or has a reserved name.
    """
    if not joined:
        return
    import duckdb

    found = connection.execute(
        "select view_name from duckdb_views() "
        "where not internal and database_name = current_database() union all "
        "select table_name from duckdb_tables() where database_name = current_database()"
    ).fetchall()
    taken = {name.casefold() for (name,) in found}
    connection.execute(f"create schema {JOINED}")
    for file in joined:
        name = identifier(file.name)
        if file.name.casefold() in taken & reserved:
            raise InputError(
                f"--with: the macros read the table {file.name}; give {file.path.name} another name"
            )
        if file.name.casefold() in taken:
            name = f"{JOINED}.{name}"
        try:
            connection.execute(f"create view {name} as {file.query}")
        except duckdb.Error as error:
            raise InputError(f"--with: cannot read {file.path}: {first_line(error)}") from error
        connection.execute(f"comment on view {name} is {literal(f'joined: {file.path}')}")
