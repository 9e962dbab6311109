"""Temporary folders, which the next process of their kind removes where one was killed."""

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
def scratch(purpose: str, within: Path | None = None) -> Iterator[Path]:
    """A folder for the block, in another or where the system has temporary ones.

    Those that killed processes left there for the same purpose are removed.
    """
    root = within or Path(tempfile.gettempdir())
    prefix = f"roomtables-{purpose}-"
    for path in root.glob(f"{prefix}????????"):
        with suppress(OSError):
            found = path.lstat()
            if found.st_uid == os.geteuid() and found.st_mode == stat.S_IFDIR | stat.S_IRWXU:
                remove_abandoned(path)
    while True:
        folder = tempfile.TemporaryDirectory("", prefix, root, ignore_cleanup_errors=True)
        with folder, held(Path(folder.name)):
            if os.path.isdir(folder.name):  # else it was taken for left over before it was held
                yield Path(folder.name)
                return
