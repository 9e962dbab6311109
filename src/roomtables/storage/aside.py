"""Files that are written aside and renamed into place; folders that go from their name at once.

Whoever writes a file aside holds a lock on it, which the system frees when the process dies. So
what nobody holds is left over from a killed process, and the next one removes it.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

REMOVING = ".removing-"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write to, which takes the place of ``path`` in one rename when the block ends.

    A link stays, and what it names is replaced. A device, a pipe or a socket is written through:
    it is handed out itself. What killed processes left of writing the same file is removed.
    """
    if _written_through(path):
        yield path
        return
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    for abandoned in asides(target.parent, target.name):
        remove_abandoned(abandoned)
    aside, descriptor = _new_aside(target)
    try:
        yield aside
        os.fsync(descriptor)
        os.replace(aside, target)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)
    sync_folder(target.parent)


def _written_through(path: Path) -> bool:
    """Whether a path is no regular file, or one that this process has open (``/dev/stdout``)."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            return True
    except FileNotFoundError:
        return False
    while path.is_symlink():
        if Path(os.path.realpath(path.parent)).is_relative_to("/proc"):
            return True
        path = path.parent / path.readlink()
    return False


def _new_aside(target: Path) -> tuple[Path, int]:
    """An empty file beside another, and its descriptor, which holds it while it is written."""
    while True:
        aside = target.with_name(f".{target.name}.{os.urandom(4).hex()}.tmp")
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        descriptor = os.open(aside, flags, 0o666)
        with suppress(OSError):  # a file system without locks: nobody takes it for left over
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            return aside, descriptor
        os.close(descriptor)  # removed a moment ago, before it was held


def asides(folder: Path, name: str | None = None) -> list[Path]:
    """Files that are, or were, being written aside in a folder: of one name, or all."""
    of_name = re.escape(name) if name else ".+"
    pattern = re.compile(rf"\.{of_name}\.[0-9a-f]{{1,8}}\.tmp")  # a process id, in older tables
    return sorted(path for path in folder.glob(".*.tmp") if pattern.fullmatch(path.name))


def remove_abandoned(path: Path) -> bool:
    """Remove a file or a folder unless a process holds it, or it cannot be locked; whether so."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            shutil.rmtree(path)
        else:
            path.unlink()
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True


def remove_folder(folder: Path) -> None:
    """Remove a folder: from its name at once, then file by file.

    What a kill leaves begins with ``REMOVING``.
    """
    aside = folder.with_name(f"{REMOVING}{folder.name}")
    shutil.rmtree(aside, ignore_errors=True)
    os.replace(folder, aside)
    shutil.rmtree(aside)


def sync_folder(folder: Path) -> None:
    """Let the names in a folder outlast a power cut, where its file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def sync_files(folder: Path) -> None:
    """Let all files in a folder outlast a power cut."""
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir():
            sync_folder(path)
        else:
            with path.open("rb") as file:
                os.fsync(file.fileno())
    sync_folder(folder)
