"""Files and locks: one-line errors, atomic writes, no links that lead elsewhere, one builder.

One exclusive lock per tables folder for the builder; a shared lock on a folder for each reader that
opens its files one by one. The system frees a lock when its process dies, so none is ever stale.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import BinaryIO

from roomtables.errors import StoreError
from roomtables.storage.aside import replacing
from roomtables.storage.refusals import refusal

_CHUNK = 1 << 20  # bytes that are hashed at once
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.*)")  # as pathlib leaves it: one slash


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn what a file system refuses into one line that names the file.

    Raises
    ------
    StoreError
        Something in the folder cannot be read or written.
    """
    try:
        yield
    except OSError as error:
        raise refusal(error, folder) or error from error


def write_aside(path: Path, data: bytes) -> None:
    """Replace a file atomically: a reader sees the old content or the new, never a part.

    Raises
    ------
    StoreError
        It cannot be written; the old content is still there.
    """
    try:
        with replacing(path) as aside:
            aside.write_bytes(data)
    except OSError as error:
        raise refusal(error, path) or error from error


def sha256_of(file: BinaryIO) -> str:
    """SHA-256 of what an open file holds from here on (`hashlib` has its own from Python 3.11)."""
    digest = hashlib.sha256()
    while chunk := file.read(_CHUNK):
        digest.update(chunk)
    return digest.hexdigest()


def refuse_outside(root: Path, *paths: Path) -> None:
    """Refuse symbolic links that lead out of a folder.

    Raises
    ------
    StoreError
        A path, links followed, is not inside ``root``.
    """
    top = root.resolve()
    for path in paths:
        if path.is_symlink() and not path.resolve().is_relative_to(top):
            raise StoreError(
                f"{path} is a symbolic link out of {root}; replace it by a copy, then try again"
            )


def refuse_links(*paths: Path) -> None:
    """Refuse symbolic links where only files of this package's writing belong.

    Raises
    ------
    StoreError
        One of the paths is a symbolic link.
    """
    for path in paths:
        if path.is_symlink():
            raise StoreError(f"{path} is a symbolic link; replace it by a copy, then try again")


def listed(folder: Path) -> list[Path]:
    """What is in a folder, sorted; nothing where there is none.

    Raises
    ------
    StoreError
        It may not be read. (To ``Path.glob`` such a folder is empty.)
    """
    try:
        return sorted(folder.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise refusal(error, folder, "read") or error from error


def check_name(path: Path) -> None:
    """Refuse a path that is not text: it can be neither printed nor written into a manifest.

    Raises
    ------
    StoreError
        The path's bytes are not UTF-8, or it is a URL.
    """
    if found := _URL.match(str(path)):
        url = f"{found[1]}://{found[2]}"
        raise StoreError(
            f"{url} is a place, not a folder; run `roomtables pull {url} --tables tables`, then "
            "open tables"
        )
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        shown = str(path).encode(errors="backslashreplace").decode()
        raise StoreError(f"{shown} is not a UTF-8 name; rename it, then try again") from error


log = logging.getLogger(__name__)
_LOCK = ".build-lock"


def utc_now() -> datetime:
    """The time, in UTC, to the second."""
    return datetime.now(timezone.utc).replace(microsecond=0)


@contextmanager
def build_lock(tables: Path, wait: bool = False) -> Iterator[None]:
    """Hold the one writer's lock of a tables folder.

    Raises
    ------
    StoreError
        The folder cannot be written, or another process holds the lock and ``wait`` is false.
    """
    check_name(tables)
    path = tables / _LOCK
    try:
        tables.mkdir(parents=True, exist_ok=True)
        refuse_outside(tables, path)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise refusal(error, tables) or error from error
    try:
        _acquire(descriptor, tables, wait)
        _note(
            descriptor,
            f"process {os.getpid()} on {socket.gethostname()} since {utc_now().isoformat()}\n",
        )
        yield
        _note(descriptor, "")
    finally:
        os.close(descriptor)


def _acquire(descriptor: int, tables: Path, wait: bool) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    except BlockingIOError:
        holder = os.pread(descriptor, 200, 0).decode(errors="replace").strip() or "another process"
    except OSError as error:
        raise StoreError(
            f"{tables} cannot be locked: {error.strerror}; use a file system with flock"
        ) from error
    if not wait:
        raise StoreError(
            f"{tables} is being built by {holder}; wait for it with `roomtables build --wait`"
        )
    log.warning("%s is being built by %s; waiting for it", tables, holder)
    fcntl.flock(descriptor, fcntl.LOCK_EX)


def _note(descriptor: int, text: str) -> None:
    """Say who holds the lock; a full disk must not keep anyone from building what fits."""
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)
    except OSError:
        log.debug("the lock's holder could not be noted")


@contextmanager
def held(*folders: Path) -> Iterator[None]:
    """Keep `gc` from removing these folders' files while they are read; needs no right to write."""
    with ExitStack() as stack:
        for folder in folders:
            try:
                descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            except OSError:
                continue
            stack.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_SH)
            except OSError:  # a file system without locks: two versions are kept anyway
                log.debug("%s cannot be locked for reading", folder)
        yield


def is_held(folder: Path) -> bool:
    """Whether a reader holds a folder."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False
