"""Temporary folders outside the tables folder."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from roomtables.storage.aside import remove_abandoned
from roomtables.storage.files import held


@contextmanager
def scratch(purpose: str) -> Iterator[Path]:
    """A temporary folder; those that killed processes left for the same purpose are removed."""
    prefix = f"roomtables-{purpose}-"
    for path in Path(tempfile.gettempdir()).glob(f"{prefix}????????"):
        with suppress(OSError):
            found = path.lstat()
            if found.st_uid == os.geteuid() and found.st_mode == stat.S_IFDIR | stat.S_IRWXU:
                remove_abandoned(path)
    while True:
        folder = tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True)
        with folder, held(Path(folder.name)):
            if os.path.isdir(folder.name):  # else it was taken for left over before it was held
                yield Path(folder.name)
                return
