"""Manners with files: errors in one line, no links that lead elsewhere, names that are text."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from roomtables.errors import StoreError

_ADVICE = {
    errno.ENOSPC: "free some space, then run the command again: what is scored is kept",
    errno.EDQUOT: "free some space, then run the command again: what is scored is kept",
    errno.EFBIG: "allow bigger files (`ulimit -f`), then run the command again",
}


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
        where = error.filename or folder
        advice = _ADVICE.get(error.errno or 0, "see that the folder is writable, or use `--tables`")
        raise StoreError(f"cannot write {where}: {error.strerror or error}; {advice}") from error


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


def check_name(path: Path) -> None:
    """Refuse a path that is not text: it can be neither printed nor written into a manifest.

    Raises
    ------
    StoreError
        The path's bytes are not UTF-8.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        shown = str(path).encode(errors="backslashreplace").decode()
        raise StoreError(f"{shown} is not a UTF-8 name; rename it, then try again") from error
