"""What a place for tables is: files by name, over a network in bounded time.

What a place or its library raises becomes one line. Whatever stalls, or sends a byte now and then,
is given up.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from roomtables.errors import StoreError, first_line

CHUNK = 1 << 20
ATTEMPTS = 3
Found = TypeVar("Found")


class MissingError(StoreError):
    """A place has no file of this name."""


class Patience(NamedTuple):
    """How long a place may take.

    Attributes
    ----------
    seconds : without any answer
    bytes_per_second : the slowest that a file may come or go; counted from its first byte, and
        after ``seconds``
    """

    seconds: float = 60.0
    bytes_per_second: float = 5_000.0

    def of(self, size: int) -> float:
        """Seconds that so many bytes may take."""
        return self.seconds + size / self.bytes_per_second


PATIENCE = Patience()


class Place(Protocol):
    """Files by name, with ``/`` between folders."""

    def size(self, name: str) -> int | None:
        """The bytes of a file; ``None`` where there is none."""

    def read(self, name: str, start: int = 0) -> Iterator[bytes]:
        """The content of a file from a byte on, in chunks."""

    def write(self, name: str, source: Path | bytes) -> None:
        """Write a file whole."""

    def names(self, folder: str) -> list[str]:
        """The names in a folder; none where there is no such folder."""

    def age(self, name: str) -> float:
        """Seconds since a file was written; 0 where the place does not tell."""

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""


def shown(url: str) -> str:
    """A URL without user, password and query: for messages and notes."""
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    plain = f"{host.rpartition('@')[2]}{slash}{path}"  # a password may hold what else ends a host
    return f"{scheme}://{re.split(r'[?#]', plain, maxsplit=1)[0]}".rstrip("/")


def read_small(place: Place, name: str, most: int) -> bytes:
    """A file of a place, of so many bytes at most.

    Raises
    ------
    StoreError
        It is larger, or cannot be read.
    """
    content = b""
    for chunk in place.read(name):
        content += chunk
        if len(content) > most:
            raise StoreError(f"{name} of the place is larger than {most} bytes")
    return content


def paced(chunks: Iterator[bytes], where: str, patience: Patience) -> Iterator[bytes]:
    """The same chunks, unless they come too slowly on the whole.

    Raises
    ------
    StoreError
        They do.
    """
    began, got = time.monotonic(), 0
    for chunk in chunks:
        got += len(chunk)
        yield chunk
        if (took := time.monotonic() - began) > patience.of(got):
            raise StoreError(f"{where}: {got:,} bytes in {took:.0f} s: too slow; try again later")


def tried(call: Callable[[], Found], where: str, seconds: float, attempts: int = ATTEMPTS) -> Found:
    """What a call returns that may fail for a moment, each time in bounded time.

    Raises
    ------
    MissingError
        It raised FileNotFoundError.
    StoreError
        It goes on failing, is refused, or gave no answer.
    """
    for attempt in range(attempts):
        try:
            return _within(seconds, call, where)
        except StoreError:
            raise
        except FileNotFoundError as error:
            raise MissingError(f"there is no {where}; push again") from error
        except Exception as error:  # of any library
            if _is_lasting(error) or attempt == attempts - 1:
                reason = getattr(error, "reason", None)  # of urllib
                said = first_line(reason if isinstance(reason, Exception) else error)
                then = "see who may use it" if _is_lasting(error) else "try again later"
                raise StoreError(f"{where}: {said}; {then}") from error
            time.sleep(0.5 * 2**attempt)
    raise AssertionError(attempts)


def _is_lasting(error: Exception) -> bool:
    """Whether asking once more cannot help: but for a time-out and too many requests."""
    status = getattr(error, "status", None)
    lasting = isinstance(status, int) and 400 <= status < 500 and status not in {408, 429}
    return lasting or isinstance(error, PermissionError)


def _within(seconds: float, call: Callable[[], Found], where: str) -> Found:
    """What a call returns, in bounded time: a library's own may be none."""
    answer: list[Any] = []
    done = threading.Event()

    def run() -> None:
        try:
            answer.extend((None, call()))
        except BaseException as error:
            answer.append(error)
        done.set()

    threading.Thread(target=run, daemon=True).start()
    if not done.wait(seconds):
        raise StoreError(f"{where}: no answer for {seconds:.0f} s; try again later")
    if answer[0] is not None:
        raise answer[0]
    found: Found = answer[1]
    return found
