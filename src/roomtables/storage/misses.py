"""Misses: combinations of known objects that were asked for and that no table held.

::

    tables/<label space>/misses/<host>-<process>.jsonl   a JSON line per question, only appended to
    tables/<label space>/misses/+<robot>-<hash>.jsonl    what a robot sent: a line per combination
    tables/<label space>/misses/taken.json               how far builds have read, and what
    tables/<label space>/misses/sent.json                how far they were sent on, and what

Any number of processes may note misses while a build reads them. Robots send files, too: whatever
line is no miss is skipped, counted, and the first of a file is named.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import time
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from roomtables.labels import normalise
from roomtables.limits import JSON_BYTES, NAME_CHARACTERS, MalformedError, json_value, read_bytes
from roomtables.schemas import SOURCES
from roomtables.storage.files import write_aside

log = logging.getLogger(__name__)

TAKEN_NOTE, SENT_NOTE = "taken.json", "sent.json"
FETCHED_PREFIX = "+"  # no file of a process here begins so
LINE_BYTES = 64 << 10
TAKEN = 100_000  # combinations that are remembered as taken in
_MOST_OBJECTS = 8  # of a combination: the largest k
_MOST_TIMES = 10**9
_YEARS = range(1970, 9000)  # that every time zone's arithmetic can hold
_IDLE_SECONDS = 3600.0  # a file that was read to its end may go when nobody wrote for so long


Combination = tuple[str, tuple[str, ...]]  # a source, and objects in sentence order


class Miss(NamedTuple):
    """A combination asked for in vain; ``objects`` in sentence order, ``last_asked`` in UTC."""

    source: str
    objects: tuple[str, ...]
    times_asked: int
    last_asked: datetime


@dataclass(frozen=True)
class Misses:
    """What a ``misses`` folder held when it was read.

    Attributes
    ----------
    note : the file that says how far was read: by builds, or by those who sent them on
    open : misses that are not taken in (or sent), most asked first
    taken : source and objects of those that are, as far as they are remembered
    """

    folder: Path
    note: str
    open: tuple[Miss, ...]
    taken: frozenset[Combination]
    _ends: Mapping[str, int]

    @classmethod
    def read(cls, folder: Path, note: str = TAKEN_NOTE) -> Misses:
        """All misses of a folder; none where there is no folder. Only one's own are sent on."""
        ends, taken = _read_note(folder / note)
        counts: dict[Combination, int] = {}
        last: dict[Combination, datetime] = {}
        for path in sorted(filter(_is_text_file, folder.glob("*.jsonl"))):
            if note == SENT_NOTE and path.name.startswith(FETCHED_PREFIX):
                continue
            found, ends[path.name] = _new_misses(path, ends.get(path.name, 0))
            for miss in found:
                key = miss.source, miss.objects
                counts[key] = counts.get(key, 0) + miss.times_asked
                last[key] = max(last.get(key, miss.last_asked), miss.last_asked)
        misses = [Miss(*key, times, last[key]) for key, times in counts.items()]
        misses.sort(key=lambda miss: (-miss.times_asked, miss.source, miss.objects))
        return cls(folder, note, tuple(misses), taken, ends)

    def take_in(self, known: Container[str] | None = None, remove: bool = True) -> None:
        """Note that all that was open is taken in (or sent); drop files long read, if they may go.

        What is open is remembered by its combination, so that a build from another file of rooms
        includes it: the most asked first, and not beyond a limit. Combinations with an object that
        is not among the ``known`` names, normalised, are in no table and are not remembered.

        Raises
        ------
        StoreError
            The folder cannot be written.
        """
        paths = {name: self.folder / name for name in self._ends}
        done = [
            name
            for name, path in paths.items()
            if (_is_done(path, self._ends[name]) if remove else not path.exists())
        ]
        if not (self.open or done):
            return
        keys = [*sorted(self.taken), *((miss.source, miss.objects) for miss in self.open)]
        if known is not None:
            keys = [key for key in keys if all(normalise(name) in known for name in key[1])]
        keys = list(dict.fromkeys(keys))
        if len(keys) > TAKEN:
            log.warning("%s: %d of %d combinations are remembered", self.folder, TAKEN, len(keys))
        combinations = [[source, *objects] for source, objects in keys[:TAKEN]]
        # A crash before the second note leaves files that count as read.
        self._note_taken(self._ends, combinations)
        gone = {name for name in done if _remove(paths[name], self._ends[name])}
        if gone:
            left = {name: end for name, end in self._ends.items() if name not in gone}
            self._note_taken(left, combinations)

    def _note_taken(self, ends: Mapping[str, int], combinations: Sequence[Sequence[str]]) -> None:
        content = {"read": dict(ends), "combinations": combinations}
        write_aside(self.folder / self.note, json.dumps(content, ensure_ascii=False).encode())


def _is_text_file(path: Path) -> bool:
    """Whether a path is a regular file with a name that can be noted: no pipe that never ends."""
    try:
        path.name.encode()
        return path.is_file()
    except (OSError, UnicodeEncodeError):
        return False


def _new_misses(path: Path, start: int) -> tuple[list[Miss], int]:
    """The misses of a file from a place on, line by line, and the place behind them."""
    found: list[Miss] = []
    skipped: list[str] = []
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) < start:
                start = 0  # another file than the one that was read
            file.seek(start)
            while line := file.readline(LINE_BYTES):
                whole = line.endswith(b"\n")
                if not (whole or (len(line) == LINE_BYTES and _skip_line(file))):
                    break  # somebody is writing it
                try:
                    found += [_parse(line)] if line.strip() else []
                except MalformedError as error:
                    skipped.append(f"the one at byte {start}: {error}")
                start = file.tell()
    except OSError as error:
        log.warning("misses in %s cannot be read: %s", path, error.strerror)
    if skipped:
        log.warning("%s: lines that are no misses: %d, such as %s", path, len(skipped), skipped[0])
    return found, start


def _skip_line(file: BinaryIO) -> bool:
    """Read what is left of a line; whether it has an end."""
    while line := file.readline(LINE_BYTES):
        if line.endswith(b"\n"):
            return True
    return False


def _parse(line: bytes) -> Miss:
    """A line: one question, or as many as its ``times`` says."""
    value = json_value(line)
    if not isinstance(value, dict):
        raise MalformedError("not a JSON object")
    source, objects, asked = (value.get(key) for key in ("source", "objects", "asked"))
    if source not in SOURCES:
        raise MalformedError(f"no source is called {str(source)[:40]!r}")
    if not isinstance(objects, list) or not 1 <= len(objects) <= _MOST_OBJECTS:
        raise MalformedError(f"`objects` is no list of 1 to {_MOST_OBJECTS} names")
    if not all(isinstance(name, str) and len(name) <= NAME_CHARACTERS for name in objects):
        raise MalformedError(f"an object is no name of at most {NAME_CHARACTERS} characters")
    try:
        moment = datetime.fromisoformat(asked if isinstance(asked, str) else "")
    except ValueError:
        moment = datetime.min
    if moment.year not in _YEARS:
        raise MalformedError(f"`asked` is no time: {str(asked)[:40]!r}")
    times = value.get("times", 1)
    if type(times) is not int or not 1 <= times <= _MOST_TIMES:
        raise MalformedError(f"`times` is no number from 1 to {_MOST_TIMES}: {str(times)[:40]}")
    return Miss(source, tuple(objects), times, moment.astimezone(timezone.utc))


def _read_note(path: Path) -> tuple[dict[str, int], frozenset[Combination]]:
    """How far each file was read, and the combinations read; damaged: nothing was."""
    try:
        value: Any = json_value(read_bytes(path, JSON_BYTES))
        ends = {str(name): max(int(end), 0) for name, end in value["read"].items()}
        taken = frozenset(
            (str(row[0]), tuple(map(str, row[1:]))) for row in value["combinations"] if row[1:]
        )
    except (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError):
        return {}, frozenset()
    return ends, taken


def _is_done(path: Path, end: int) -> bool:
    """Whether a file was read to its end, and nobody writes to it any more; or is gone."""
    try:
        status = path.stat()
    except OSError:
        return True
    idle = path.name.startswith(FETCHED_PREFIX) or time.time() - status.st_mtime > _IDLE_SECONDS
    return idle and status.st_size == end


def _remove(path: Path, end: int) -> bool:
    """Remove a file unless someone writes to it; whether it is gone."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file.fileno()).st_size != end:
                return False
            path.unlink()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True
