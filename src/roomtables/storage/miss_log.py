"""Noting, in a file of each process, what was asked for in vain."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import re
import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from io import FileIO
from pathlib import Path

log = logging.getLogger(__name__)

FOLDER = "misses"
FILE_BYTES = 4 << 20  # of one process
FOLDER_BYTES = 64 << 20
_THEN = "run a build to take them in, or `roomtables push URL --misses` to send them to one"


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
                return f"this process has noted {FILE_BYTES >> 20} MB; {_THEN}"
            if size == 0 and folder_bytes(self._folder) > FOLDER_BYTES:
                return f"it holds {FOLDER_BYTES >> 20} MB; {_THEN}"
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


def folder_bytes(folder: Path) -> int:
    """The size of all files of a folder, which others may write to and remove from meanwhile."""
    total = 0
    for path in folder.iterdir():
        with suppress(FileNotFoundError):
            total += path.stat().st_size
    return total
