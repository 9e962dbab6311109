"""Misses: combinations of known objects that were asked for and that no table held.

::

    tables/<label space>/misses/<host>-<process>.jsonl   a JSON line per question, only appended to
    tables/<label space>/misses/taken.json               how far builds have read, and what

Any number of processes may note misses while a build reads them. A line torn by a crash is skipped.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import re
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

from roomtables.storage.files import write_aside

log = logging.getLogger(__name__)

FOLDER = "misses"
_TAKEN = "taken.json"
FILE_BYTES = 4 << 20  # of one process
FOLDER_BYTES = 64 << 20
_IDLE_SECONDS = 3600.0  # a file that was read to its end may go when nobody wrote for so long


class Miss(NamedTuple):
    """A combination asked for in vain; ``objects`` in sentence order, ``last_asked`` in UTC."""

    source: str
    objects: tuple[str, ...]
    times_asked: int
    last_asked: datetime


class MissLog:
    """Notes misses in a file of this process. Never raises: what cannot be noted is warned of once.

    Parameters
    ----------
    folder : the ``misses`` folder; it is made with the first miss
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._warned = False

    def note(self, source: str, combinations: Iterable[Sequence[str]]) -> None:
        """Append one line per combination."""
        asked = datetime.now(timezone.utc).isoformat(timespec="seconds")
        lines = [
            json.dumps({"source": source, "objects": list(objects), "asked": asked})
            for objects in combinations
        ]
        if not lines:
            return
        with self._lock:
            try:
                why = self._append(("\n".join(lines) + "\n").encode())
            except OSError as error:
                why = error.strerror or str(error)
            if why and not self._warned:
                self._warned = True
                log.warning("misses are not noted in %s: %s", self._folder, why)

    def _append(self, data: bytes) -> str | None:
        """Write the lines; returns why not, where there is no room for them."""
        host = re.sub(r"[^\w-]", "_", os.uname().nodename)
        path = self._folder / f"{host}-{os.getpid()}.jsonl"
        self._folder.mkdir(exist_ok=True)
        with _locked(path) as file:
            size = file.seek(0, os.SEEK_END)
            if size + len(data) > FILE_BYTES:
                return f"this process has noted {FILE_BYTES >> 20} MB; run a build to take them in"
            if size == 0 and folder_bytes(self._folder) > FOLDER_BYTES:
                return f"it holds {FOLDER_BYTES >> 20} MB; run a build to take them in"
            if size and os.pread(file.fileno(), 1, size - 1) != b"\n":
                data = b"\n" + data  # end what a crash or a full disk left of a line
            return None if file.write(data) == len(data) else "the disk is full"


def _locked(path: Path) -> FileIO:
    """The file, open for appending, which no build removes before it is closed."""
    while True:
        file = FileIO(
            os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644), "r+"
        )
        fcntl.flock(file, fcntl.LOCK_SH)
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()  # removed a moment ago


@dataclass(frozen=True)
class Misses:
    """What a ``misses`` folder held when it was read.

    Attributes
    ----------
    open : misses that no build has taken in, most asked first
    taken : source and objects of those that builds have taken in
    """

    folder: Path
    open: tuple[Miss, ...]
    taken: frozenset[tuple[str, tuple[str, ...]]]
    _ends: Mapping[str, int]

    @classmethod
    def read(cls, folder: Path) -> Misses:
        """All misses of a folder; none where there is no folder."""
        ends, taken = _read_taken(folder)
        counts: dict[tuple[str, tuple[str, ...]], int] = {}
        last: dict[tuple[str, tuple[str, ...]], datetime] = {}
        for path in sorted(folder.glob("*.jsonl")):
            lines, ends[path.name] = _new_lines(path, ends.get(path.name, 0))
            for line in lines:
                found = _parse(line)
                if found:
                    key, asked = found
                    counts[key] = counts.get(key, 0) + 1
                    last[key] = max(last.get(key, asked), asked)
        misses = [Miss(*key, times, last[key]) for key, times in counts.items()]
        misses.sort(key=lambda miss: (-miss.times_asked, miss.source, miss.objects))
        return cls(folder, tuple(misses), taken, ends)

    def take_in(self) -> None:
        """Note that a published version answers all that was open; drop files long read.

        Raises
        ------
        StoreError
            The folder cannot be written.
        """
        dropped = [name for name in self._ends if _is_done(self.folder / name, self._ends[name])]
        taken = self.taken | {(miss.source, miss.objects) for miss in self.open}
        if not (self.open or dropped):
            return
        content = {
            "read": {name: end for name, end in self._ends.items() if name not in dropped},
            "combinations": [[source, *objects] for source, objects in sorted(taken)],
        }
        text = json.dumps(content, ensure_ascii=False)
        write_aside(self.folder / _TAKEN, text.encode())
        for name in dropped:
            _remove(self.folder / name, self._ends[name])


def folder_bytes(folder: Path) -> int:
    """The size of all files of a folder, which others may write to and remove from meanwhile."""
    total = 0
    for path in folder.iterdir():
        with suppress(FileNotFoundError):
            total += path.stat().st_size
    return total


def _new_lines(path: Path, start: int) -> tuple[list[bytes], int]:
    """Whole lines from a place in a file, and the place behind them."""
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) < start:
                start = 0  # another file than the one that was read
            file.seek(start)
            content = file.read()
    except OSError as error:
        log.warning("misses in %s cannot be read: %s", path, error.strerror)
        return [], start
    whole = content[: content.rfind(b"\n") + 1]
    return whole.splitlines(), start + len(whole)


def _parse(line: bytes) -> tuple[tuple[str, tuple[str, ...]], datetime] | None:
    """Source and objects, and when; ``None`` for a line that is no miss."""
    try:
        value: Any = json.loads(line)
        source, objects = value["source"], value["objects"]
        asked = datetime.fromisoformat(value["asked"]).astimezone(timezone.utc)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    names = isinstance(objects, list) and objects and all(isinstance(o, str) for o in objects)
    return ((source, tuple(objects)), asked) if names and isinstance(source, str) else None


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _read_taken(folder: Path) -> tuple[dict[str, int], frozenset[tuple[str, tuple[str, ...]]]]:
    """How far each file was read, and the combinations read; damaged: nothing was."""
    try:
        value: Any = json.loads(_text(folder / _TAKEN))
        ends = {str(name): int(end) for name, end in value["read"].items()}
        taken = frozenset(
            (str(row[0]), tuple(map(str, row[1:]))) for row in value["combinations"] if row[1:]
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError):
        return {}, frozenset()
    return ends, taken


def _is_done(path: Path, end: int) -> bool:
    """Whether a file was read to its end, and nobody has written to it for long; or is gone."""
    try:
        status = path.stat()
    except OSError:
        return True
    return status.st_size == end and time.time() - status.st_mtime > _IDLE_SECONDS


def _remove(path: Path, end: int) -> None:
    """Remove a file unless someone writes to it."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file.fileno()).st_size == end:
                path.unlink()
    except OSError:
        return
