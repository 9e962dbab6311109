"""Places that tables travel through: a folder by ``file://``, or anything that fsspec reaches.

A place is only written to by `push`, and only read by `pull`. What a place or its library raises
becomes one line; what stalls is given up after ``STALLED_SECONDS`` without a byte.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol, TypeVar
from urllib.parse import unquote, urlsplit

from roomtables.errors import InputError, StoreError, first_line, needing
from roomtables.storage.aside import replacing
from roomtables.storage.files import refuse_links, writing

CHUNK = 1 << 20
STALLED_SECONDS = 60.0
ATTEMPTS = 3
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
Found = TypeVar("Found")


class MissingError(StoreError):
    """A place has no file of this name."""


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


def open_place(url: str) -> Place:
    """The place at a URL.

    Raises
    ------
    InputError
        It is no URL, of an unknown protocol, or has a query.
    MissingExtraError
        fsspec is not installed.
    """
    if not _URL.match(url):
        raise InputError(f"{url!r} is no URL; name a place like s3://bucket/tables or file:///mnt")
    parts = urlsplit(url)
    if parts.query or parts.fragment:
        raise InputError(f"{shown(url)}: a place's URL has no `?` and no `#`")
    if parts.scheme.lower() == "file":
        return _Folder(Path(unquote(parts.netloc + parts.path)))
    return _Remote.open(url)


def shown(url: str) -> str:
    """A URL without user, password and query: for messages and notes."""
    scheme, _, rest = re.split(r"[?#]", url, maxsplit=1)[0].partition("://")
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}".rstrip("/")


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


class _Folder:
    """A folder of this machine: files are written aside, flushed, and renamed into place."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def size(self, name: str) -> int | None:
        path = self._root / name
        with writing(path):
            try:
                return path.stat().st_size
            except (FileNotFoundError, NotADirectoryError):
                return None

    def read(self, name: str, start: int = 0) -> Iterator[bytes]:
        path = self._root / name
        with writing(path):
            try:
                file = path.open("rb")
            except (FileNotFoundError, NotADirectoryError):
                raise MissingError(f"there is no {path}") from None
            with file:
                file.seek(start)
                while chunk := file.read(CHUNK):
                    yield chunk

    def write(self, name: str, source: Path | bytes) -> None:
        path = self._root / name
        folders = list(path.relative_to(self._root).parents)[:-1]
        refuse_links(path, *(self._root / folder for folder in folders))
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as aside, aside.open("wb") as target:
                for chunk in _chunks(source):
                    target.write(chunk)

    def names(self, folder: str) -> list[str]:
        path = self._root / folder
        with writing(path):
            try:
                return sorted(found.name for found in path.iterdir() if found.is_file())
            except (FileNotFoundError, NotADirectoryError):
                return []

    def age(self, name: str) -> float:
        with suppress(OSError):
            return time.time() - (self._root / name).stat().st_mtime
        return 0.0

    def remove(self, name: str) -> None:
        with writing(self._root / name):
            (self._root / name).unlink(missing_ok=True)


class _Remote:
    """What fsspec reaches."""

    def __init__(self, system: Any, root: str, url: str) -> None:
        self._system, self._root, self._url = system, root.rstrip("/"), shown(url)

    @classmethod
    def open(cls, url: str) -> _Remote:
        with needing("a place other than file://", "remote"):
            from fsspec.core import url_to_fs

        scheme = urlsplit(url).scheme.lower()
        options: dict[str, Any] = {"use_listings_cache": False, "skip_instance_cache": True}
        if scheme in {"http", "https"}:
            options["client_kwargs"] = {"trust_env": True}
            options["headers"] = {"Cache-Control": "no-cache", "Accept-Encoding": "identity"}
        try:
            system, root = url_to_fs(url, **({} if scheme == "memory" else options))
        except ImportError as error:
            lacks = getattr(error.__cause__, "name", None) or getattr(error, "name", None)
            package = (lacks or "a package of its own").partition(".")[0]
            raise InputError(f"{scheme}:// needs {package}; run `pip install {package}`") from error
        except Exception as error:
            raise InputError(f"{shown(url)} cannot be opened: {first_line(error)}") from error
        return cls(system, root, url)

    def size(self, name: str) -> int | None:
        try:
            found = self._try(name, lambda: self._system.info(self._path(name)))
        except MissingError:
            return None
        return int(found.get("size") or 0)

    def read(self, name: str, start: int = 0) -> Iterator[bytes]:
        file = self._try(name, lambda: self._opened(name, start))
        try:
            while chunk := self._try(name, lambda: file.read(CHUNK), 1):
                yield chunk
        finally:
            with suppress(Exception):  # it comes too late to matter
                file.close()

    def _opened(self, name: str, start: int) -> Any:
        file = self._system.open(self._path(name), "rb", cache_type="none")
        left = start
        try:
            file.seek(start)
        except ValueError:  # a server without ranges: what is here already is read again
            while left and (chunk := file.read(min(left, CHUNK))):
                left -= len(chunk)
        return file

    def write(self, name: str, source: Path | bytes) -> None:
        path = self._path(name)

        def put() -> None:
            with suppress(NotImplementedError):
                self._system.makedirs(path.rpartition("/")[0], exist_ok=True)
            if isinstance(source, bytes):
                self._system.pipe_file(path, source)
            else:
                self._system.put_file(str(source), path)

        big = 0 if isinstance(source, bytes) else source.stat().st_size
        self._try(name, put, seconds=STALLED_SECONDS + big / 20_000)

    def names(self, folder: str) -> list[str]:
        try:
            found = self._try(folder, lambda: self._system.ls(self._path(folder), detail=False))
        except MissingError:
            return []
        return sorted({str(path).rstrip("/").rpartition("/")[2] for path in found})

    def age(self, name: str) -> float:
        try:
            modified = self._try(name, lambda: self._system.modified(self._path(name)), 1)
            return time.time() - float(modified.timestamp())
        except (StoreError, AttributeError):
            return 0.0

    def remove(self, name: str) -> None:
        with suppress(MissingError):
            self._try(name, lambda: self._system.rm_file(self._path(name)))

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _try(
        self,
        name: str,
        call: Callable[[], Found],
        attempts: int = ATTEMPTS,
        seconds: float | None = None,
    ) -> Found:
        """Call what may fail for a moment; one line where it goes on failing."""
        where = f"{self._url}/{name}"
        for attempt in range(attempts):
            try:
                return _within(seconds or STALLED_SECONDS, call, where)
            except StoreError:
                raise
            except FileNotFoundError as error:
                raise MissingError(f"there is no {where}") from error
            except Exception as error:  # of any library
                status = getattr(error, "status", 500)
                lasting = isinstance(error, PermissionError) or 400 <= status < 500
                if lasting or attempt == attempts - 1:
                    raise StoreError(f"{where}: {first_line(error)}; try again later") from error
                time.sleep(0.5 * 2**attempt)
        raise AssertionError(attempts)


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


def _chunks(source: Path | bytes) -> Iterator[bytes]:
    if isinstance(source, bytes):
        yield source
        return
    file: BinaryIO
    with source.open("rb") as file:
        while chunk := file.read(CHUNK):
            yield chunk
