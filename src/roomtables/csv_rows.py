"""Rows of a CSV file, each with its place, for messages that name file and line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.limits import CSV_BYTES, MalformedError, decoded, read_bytes


def csv_lines(path: Path, **dialect: Any) -> Iterator[tuple[str, list[str]]]:
    """Rows of a CSV file, each with its place (``FILE, line N``); ``dialect`` as `csv.reader`'s.

    Raises
    ------
    InputError
        The file cannot be read, is too large or is not UTF-8, or a row breaks CSV's rules.
    """
    try:
        text = decoded(read_bytes(path, CSV_BYTES))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except MalformedError as error:
        raise InputError(f"{path}: {error}; save it as CSV in UTF-8") from error
    reader = csv.reader(io.StringIO(text, newline=""), **dialect)
    try:
        for row in reader:
            yield f"{path}, line {reader.line_num}", row
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: {error}") from error


def read_csv(path: Path, required: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a CSV file with a header, each with its place (``FILE, line N``).

    Raises
    ------
    InputError
        As `csv_lines`, or a required column is missing, or a row has more or fewer fields than the
        header.
    """
    rows = csv_lines(path, strict=True)
    header = [name.strip() for name in next(rows, ("", []))[1]]
    missing = [column for column in required if column not in header]
    if missing:
        raise InputError(
            f"{path}: missing column `{missing[0]}`; its header must hold {','.join(required)}"
        )
    for where, row in rows:
        if row and len(row) != len(header):
            raise InputError(f"{where}: expected {len(header)} fields, as in the header")
        if row:
            yield where, dict(zip(header, row, strict=True))
