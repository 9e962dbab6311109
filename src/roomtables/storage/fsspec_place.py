"""A place that fsspec reaches: S3, Google Cloud Storage, the Hugging Face Hub, and others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from roomtables.errors import InputError, StoreError, first_line, needing
from roomtables.storage.place import ATTEMPTS, CHUNK, MissingError, Patience, paced, shown, tried

Found = TypeVar("Found")


class FsspecPlace:
    """Files of a file system of fsspec's.

    Parameters
    ----------
    system : an ``fsspec.AbstractFileSystem``
    root : the path there
    url : the place's, as messages show it
    """

    def __init__(self, system: Any, root: str, url: str, patience: Patience) -> None:
        self._system, self._root, self._url = system, root.rstrip("/"), url
        self._patience = patience

    @classmethod
    def open(cls, url: str, patience: Patience) -> FsspecPlace:
        """The place at a URL.

        Raises
        ------
        InputError
            fsspec does not know the protocol, or lacks that protocol's package.
        MissingExtraError
            fsspec is not installed.
        """
        with needing("a place other than file:// and https://", "remote"):
            from fsspec.core import url_to_fs

        scheme = urlsplit(url).scheme.lower()
        fresh = {"use_listings_cache": False, "skip_instance_cache": True}
        try:
            system, root = url_to_fs(url, **({} if scheme == "memory" else fresh))
        except ImportError as error:
            lacks = getattr(error.__cause__, "name", None) or getattr(error, "name", None)
            package = (lacks or "a package of its own").partition(".")[0]
            raise InputError(f"{scheme}:// needs {package}; run `pip install {package}`") from error
        except Exception as error:  # of any library
            raise InputError(f"{shown(url)} cannot be opened: {first_line(error)}") from error
        return cls(system, root, shown(url), patience)

    def size(self, name: str) -> int | None:
        try:
            found = self._try(name, lambda: self._system.info(self._path(name)))
        except MissingError:
            return None
        return int(found.get("size") or 0)

    def read(self, name: str, start: int = 0) -> Iterator[bytes]:
        yield from paced(self._chunks(name, start), f"{self._url}/{name}", self._patience)

    def _chunks(self, name: str, start: int) -> Iterator[bytes]:
        def begin() -> tuple[Any, bytes]:
            file = self._system.open(self._path(name), cache_type="none")
            file.seek(start)
            return file, file.read(CHUNK)

        # As one: it may be written anew between the two, which some libraries refuse to read.
        file, chunk = self._try(name, begin, size=CHUNK)
        try:
            while chunk:
                yield chunk
                chunk = self._try(name, lambda: file.read(CHUNK), 1, CHUNK)
        finally:
            with suppress(Exception):  # it comes too late to matter
                file.close()

    def write(self, name: str, source: Path | bytes) -> None:
        path = self._path(name)

        def put() -> None:
            if isinstance(source, bytes):
                self._system.pipe_file(path, source)
            else:
                self._system.put_file(str(source), path)

        def put_into_folder() -> None:
            try:
                put()
            except FileNotFoundError:
                self._make_folders(name)
                put()

        size = len(source) if isinstance(source, bytes) else source.stat().st_size
        try:
            self._try(name, put_into_folder, size=size)
        except MissingError as error:
            raise StoreError(
                f"{self._url} cannot be written: there is no such bucket or folder; make it, then "
                "push again"
            ) from error

    def _make_folders(self, name: str) -> None:
        """The folders of a file, where a place has such; never a bucket, whose name may be a slip
        of the hand."""
        levels = [self._root, *(self._path(folder) for folder in _folders(name))]
        for folder in levels:
            if "/" in folder:
                with suppress(FileExistsError, NotImplementedError):
                    self._system.mkdir(folder, create_parents=False)

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
        self, name: str, call: Callable[[], Found], attempts: int = ATTEMPTS, size: int = 0
    ) -> Found:
        """Call what answers in the time that so many bytes may take."""
        return tried(call, f"{self._url}/{name}", self._patience.of(size), attempts)


def _folders(name: str) -> list[str]:
    """The folders that a name is in, outermost first."""
    parts = name.split("/")[:-1]
    return ["/".join(parts[: end + 1]) for end in range(len(parts))]
