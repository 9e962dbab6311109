"""What the system or a library refuses (disk, memory, permission), in this package's words.

DuckDB, pyarrow, numpy and torch each raise their own exceptions when a disk is full or memory runs
out; here they become one line that says what, where, and what to do. None of them is imported: an
exception is told by the package that it comes from and by what it says.
"""

from __future__ import annotations

import errno
import os
import pwd
import re
import shutil
import stat
from pathlib import Path

from roomtables.errors import StoreError, first_line
from roomtables.memory import MEGABYTE, address_space_limit

_AGAIN = "then run the command again: what is scored is kept"
_KNOWN = (
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EPERM, errno.EROFS, errno.EIO,
    errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENAMETOOLONG,
)  # fmt: skip
_ADVICE = {
    errno.EFBIG: f"allow bigger files (`ulimit -f`), {_AGAIN}",
    errno.EROFS: "use a folder on another file system (`--tables DIR`, `-o FILE`)",
    errno.EIO: "the disk may be failing: see the system's log",
    errno.EMFILE: "allow more open files (`ulimit -n`), then run the command again",
    errno.ENFILE: "the whole system has too many files open; try again later",
    errno.ENAMETOOLONG: "use a shorter path",
}
# What libraries say instead of the system's own words, in lower case.
_NO_MEMORY = (
    "bad_alloc", "can't allocate memory", "can't start new thread", "failed to map segment",
    "resource temporarily unavailable",
)  # fmt: skip
_SHORT_WRITE = re.compile(r"\d+ requested and \d+ written")  # numpy, which keeps no errno
_SPILL = "max_temp_directory_size"  # DuckDB: no room on the disk for what memory cannot hold
_QUOTED = re.compile(r'file \\*"(/[^"\\]+)')
# DuckDB's exceptions that tell of a machine rather than of a query.
_OF_THE_MACHINE = {
    "IOException", "TransactionException", "FatalException", "OutOfMemoryException",
}  # fmt: skip


def refusal(
    error: BaseException, where: Path | None = None, doing: str = "write"
) -> StoreError | None:
    """A foreign exception in one line; ``None`` where it is none of disk, memory or permission.

    Parameters
    ----------
    error : what was raised
    where : the file or folder that was worked on, where the exception does not say
    doing : what was tried: ``read``, ``write`` or ``use``
    """
    number = _number(error)
    if number == errno.ENOMEM:
        return StoreError(_out_of_memory(error))
    path = _path(error) or where
    shown = f" {path}" if path else ""
    if number in {errno.ENOSPC, errno.EDQUOT}:
        return StoreError(f"cannot write{shown}: {_full(number, path)}; free some space, {_AGAIN}")
    if number in {errno.EACCES, errno.EPERM}:
        return StoreError(f"cannot {doing}{shown}: {_denied(path)}")
    if number is None and not (isinstance(error, OSError) or _of_the_machine(error)):
        return None
    said = os.strerror(number) if number else first_line(error)
    other = "see that the path is right, or use another (`--tables DIR`, `-o FILE`)"
    return StoreError(f"cannot {doing}{shown}: {said}; {_ADVICE.get(number or 0, other)}")


def _number(error: BaseException) -> int | None:
    """The system's number for what happened, from the exception or from what it says."""
    text = str(error)
    if _out_of_room(error, text):
        return errno.ENOSPC
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryException":
        return errno.ENOMEM
    if isinstance(error, OSError) and error.errno:
        return error.errno
    if not (isinstance(error, OSError | RuntimeError | ImportError) or _of_duckdb(error)):
        return None
    for number in _KNOWN:
        if os.strerror(number) in text:
            return number
    return errno.ENOMEM if any(words in text.lower() for words in _NO_MEMORY) else None


def _out_of_room(error: BaseException, text: str) -> bool:
    return _SPILL in text or (isinstance(error, OSError) and bool(_SHORT_WRITE.search(text)))


def _of_the_machine(error: BaseException) -> bool:
    """Whether an exception of DuckDB tells of the machine; those of SQL are bugs or user errors."""
    return _of_duckdb(error) and type(error).__name__ in _OF_THE_MACHINE


def _of_duckdb(error: BaseException) -> bool:
    return type(error).__module__.partition(".")[0] in {"duckdb", "_duckdb"}


def _path(error: BaseException) -> Path | None:
    """The file that an exception names."""
    named = getattr(error, "filename", None)
    if isinstance(named, str | bytes) and named:
        return Path(os.fsdecode(named))
    quoted = _QUOTED.search(str(error))
    return Path(quoted[1]) if quoted else None


def _full(number: int, path: Path | None) -> str:
    """How much room is left, and where."""
    found = _existing(path or Path())
    folder = found if found.is_dir() else found.parent
    what = "the disk quota is used up" if number == errno.EDQUOT else "the disk is full"
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return what
    return f"{what} ({free / 1000:,.0f} kB free in {folder})"


def _denied(path: Path | None) -> str:
    """Whose the file or folder is that refused, and what to do."""
    advice = "or use another folder (`--tables DIR`, `-o FILE`)"
    if path is None:
        return f"permission denied; ask its owner for access, {advice}"
    culprit = _existing(path)
    facts = culprit.stat()
    mode, owner = stat.S_IMODE(facts.st_mode), _user(facts.st_uid)
    return (
        f"permission denied ({culprit} belongs to {owner}, mode {mode:03o}; you are "
        f"{_user(os.geteuid())}); ask {owner} for access, {advice}"
    )


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"


def _existing(path: Path) -> Path:
    """The path, or the nearest folder above it that can be looked at."""
    for candidate in (path, *path.absolute().parents):
        try:
            candidate.stat()
        except OSError:
            continue
        return candidate
    return Path("/")


def _out_of_memory(error: BaseException) -> str:
    limit = address_space_limit()
    most = f" under a limit of {limit // MEGABYTE} MB (`ulimit -v`)" if limit else ""
    return (
        f"out of memory{most}: {first_line(error)}; raise the limit or free memory, or ask for "
        "less at once (a smaller `-k`, `--combinations`, or input), then run the command again"
    )
