"""A place that is a folder of this machine, such as a mount that others see, too."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from roomtables.storage.aside import replacing
from roomtables.storage.files import refuse_links, writing
from roomtables.storage.place import CHUNK, MissingError


class FolderPlace:
    """A folder: files are written aside, flushed, and renamed into place."""

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
                raise MissingError(f"there is no {path}; push again") from None
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


def _chunks(source: Path | bytes) -> Iterator[bytes]:
    if isinstance(source, bytes):
        yield source
        return
    with source.open("rb") as file:
        while chunk := file.read(CHUNK):
            yield chunk
