"""What is printed is safe: nothing in a name or a message can steer a terminal or a spreadsheet.

Labels, ids, file names and messages come from files that others wrote. Control characters, bidi
overrides and lone surrogates are shown as escapes (``\\x1b``); JSON holds them as ``\\u001b``, and
whoever parses it gets the name as it was.
"""

from __future__ import annotations

import json
import logging
import re

import click

# C0, DEL and C1, line separators, bidi embeddings, overrides and isolates, lone surrogates.
_UNSAFE = "\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff"
_IN_LINES = re.compile(f"[{_UNSAFE}]")
_IN_TEXT = re.compile(f"(?![\n])[{_UNSAFE}]")
# A spreadsheet runs a cell that begins so as a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str) -> str:
    """A text of several lines, with what would steer a terminal escaped."""
    return _IN_TEXT.sub(_escaped, text)


def in_one_line(text: str) -> str:
    """A cell or a message, line ends escaped too."""
    return _IN_LINES.sub(_escaped, text)


def _escaped(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape").decode("ascii")


def csv_cell(text: str) -> str:
    """A cell of text in one line, which no spreadsheet takes for a formula.

    One that begins with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return gets a ``'`` in
    front, as spreadsheets themselves mark text.
    """
    return f"'{in_one_line(text)}" if text.startswith(_FORMULA) else in_one_line(text)


def as_json(value: object) -> str:
    """Indented JSON, with a line end."""
    return _json(value, indent=2)


def as_json_line(value: object) -> str:
    """JSON on one line, with a line end."""
    return _json(value)


def _json(value: object, indent: int | None = None) -> str:
    return safe_json(json.dumps(value, indent=indent, ensure_ascii=False, default=str)) + "\n"


def safe_json(text: str) -> str:
    """JSON text that says the same, with what would steer a terminal escaped as JSON has it."""
    return _IN_TEXT.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text that may hold names from anywhere."""
    click.echo(printable(text), err=err, nl=nl)


class LogFormatter(logging.Formatter):
    """Log lines in which names are escaped; a traceback below one keeps its line ends."""

    def __init__(self) -> None:
        super().__init__("%(levelname)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  (logging's name)
        return in_one_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def log_to_stderr() -> None:
    """Show warnings of this package and of those it uses, on stderr."""
    handler = logging.StreamHandler()
    handler.setFormatter(LogFormatter())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.addLevelName(logging.WARNING, "warning")
    logging.addLevelName(logging.INFO, "info")
