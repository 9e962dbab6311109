"""Published versions on disk: found through ``CURRENT``, written aside, moved into place.

::

    tables/<label space>/CURRENT            names the published version
    tables/<label space>/<version>/manifest.json, *.parquet, lookup/, model/ (exported ones)

A reader opens through ``CURRENT`` once and keeps what it opened; a writer never touches a published
file. This module needs no pyarrow and no duckdb.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roomtables.errors import StoreError
from roomtables.limits import JSON_BYTES, MalformedError, read_bytes
from roomtables.storage.aside import sync_files, sync_folder
from roomtables.storage.files import check_name, refuse_links, refuse_outside, write_aside, writing
from roomtables.storage.manifest import FileFacts, Manifest, ManifestError, SchemaVersionError

MANIFEST = "manifest.json"
CURRENT = "CURRENT"
LOOKUP = "lookup"
MODEL = "model"  # the folder of a language model, in tables that were exported with one
STAGING = ".staging-"
_KEPT = "what is scored is kept"
# A number and the inputs' hash; in an archive, the manifest's hash, too.
NAME = re.compile(r"\d{6,}-\w+(-[0-9a-f]{8})?")


@dataclass(frozen=True)
class Version:
    """One published version: its folder and its manifest."""

    path: Path
    manifest: Manifest

    @property
    def name(self) -> str:
        return self.path.name

    def damaged_files(self) -> Iterator[tuple[str, str]]:
        """The files that are not as the manifest notes, by path inside the version, and how.

        ``removed``, or ``damaged``: another size or another hash.
        """
        for name, noted in self.manifest.files.items():
            path = self.path / name
            if not path.is_file():
                yield name, "removed"
            elif FileFacts.of(path) != noted:
                yield name, "damaged"

    def verify(self) -> None:
        """Compare every file with the size and the hash that the manifest notes.

        Raises
        ------
        StoreError
            A file is missing, cut, or has a bit flipped; the message names it.
        """
        for name, _ in self.damaged_files():
            raise StoreError(
                f"{self.path / name} is damaged; run `roomtables build` to make it again"
            )

    @classmethod
    def open(cls, path: Path, sha256: str | None = None) -> Version:
        """The version in a folder; ``sha256`` is its manifest's hash, where that is known.

        Raises
        ------
        StoreError
            Its manifest is missing, damaged, another than the hash says, or of another schema
            version; or one of its files is a symbolic link.
        """
        manifest_path = path / MANIFEST
        refuse_outside(path.parent.parent, path, manifest_path, path / LOOKUP)
        try:
            content = read_bytes(manifest_path, JSON_BYTES)
        except (OSError, MalformedError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise StoreError(
                f"cannot read {manifest_path}: {why}; run `roomtables build`"
            ) from error
        try:
            manifest = Manifest.from_bytes(content)
        except SchemaVersionError as error:
            raise StoreError(f"{path}: {error}; run `roomtables build`: {_KEPT}") from error
        except ManifestError as error:
            raise StoreError(
                f"{manifest_path} is damaged ({error}); run `roomtables build`: {_KEPT}"
            ) from error
        if sha256 not in {None, hashlib.sha256(content).hexdigest()}:
            raise StoreError(
                f"{manifest_path} is not the one that {CURRENT} names; "
                f"run `roomtables build`: {_KEPT}"
            )
        refuse_links(manifest_path, path / LOOKUP, *(path / name for name in manifest.files))
        return cls(path, manifest)


class Pointer(NamedTuple):
    """What ``CURRENT`` says: the version's name, and the SHA-256 of its manifest.

    Tables of the schema before had no hash there: ``sha256`` is then empty.
    """

    name: str
    sha256: str

    @classmethod
    def of(cls, version: Path) -> Pointer:
        """The pointer to a version whose manifest is written."""
        return cls(version.name, FileFacts.of(version / MANIFEST).sha256)

    @classmethod
    def parse(cls, text: str) -> Pointer:
        name, _, sha256 = text.strip().partition(" ")
        return cls(name, sha256)

    def to_bytes(self) -> bytes:
        """The line that ``CURRENT`` holds."""
        return f"{self.name} {self.sha256}\n".encode()


class SpaceFolder:
    """The versions of one label space under a tables folder."""

    def __init__(self, tables: Path, labels: str) -> None:
        check_name(tables)
        check_name(tables / labels)
        self.labels = labels
        self.path = tables / labels

    def current(self) -> Version:
        """The published version.

        Raises
        ------
        StoreError
            Nothing is published, ``CURRENT`` names nothing, or the version cannot be opened.
        """
        pointer = self.path / CURRENT
        refuse_outside(self.path.parent, self.path, pointer)
        try:
            name, sha256 = Pointer.parse(pointer.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise StoreError(
                f"no tables for {self.labels} in {self.path.parent}{self._others()}; "
                f"run `roomtables build --labels {self.labels} --tables {self.path.parent}`"
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise StoreError(f"cannot read {pointer}: {error}; run `roomtables build`") from error
        version = self.path / name
        if not name or Path(name).name != name or not (version / MANIFEST).is_file():
            raise StoreError(
                f"{pointer} names {name!r}, which is not there; run `roomtables build`"
            )
        if not sha256:
            Version.open(version)  # says which schema version it has
            raise StoreError(
                f"{pointer} lacks its manifest's hash; run `roomtables build`: {_KEPT}"
            )
        return Version.open(version, sha256)

    def pointer(self) -> bytes:
        """What ``CURRENT`` says now; nothing where there is none."""
        try:
            return (self.path / CURRENT).read_bytes()
        except OSError:
            return b""

    def named_by_current(self) -> Path | None:
        """The folder that ``CURRENT`` names, whether or not it can be opened."""
        try:
            name = Pointer.parse(self.pointer().decode()).name
        except UnicodeDecodeError:
            return None
        path = self.path / name
        return path if name and Path(name).name == name and path.is_dir() else None

    def published(self) -> Version | None:
        """The published version, or ``None`` where nothing usable is published."""
        try:
            return self.current()
        except StoreError:
            return None

    def versions(self) -> list[Path]:
        """Folders of the versions, oldest first."""
        if not self.path.is_dir():
            return []
        found = (path.parent for path in self.path.glob(f"[0-9]*/{MANIFEST}"))
        return sorted(path for path in found if NAME.fullmatch(path.name))

    def new_name(self, fingerprint: str) -> str:
        """A name for the next version: a number, which no clock can turn back, and its inputs."""
        numbers = [int(n) for path in self.versions() if (n := path.name.split("-")[0]).isdigit()]
        return f"{max(numbers, default=0) + 1:06d}-{fingerprint[:8]}"

    def publish(self, staging: Path, name: str, manifest: Manifest) -> Version:
        """Write the manifest, move the staged folder into place, and point ``CURRENT`` at it."""
        target = self.path / name
        if target.exists():
            raise StoreError(f"{target} exists already; run `roomtables gc`, then build again")
        write_aside(staging / MANIFEST, manifest.to_bytes())
        with writing(target):
            sync_files(staging)
            os.replace(staging, target)
            sync_folder(self.path)
            sync_folder(self.path.parent)
        return self.point_at(target)

    def point_at(self, version: Path) -> Version:
        """Make a version the published one."""
        pointer = Pointer.of(version)
        opened = Version.open(version, pointer.sha256)
        write_aside(self.path / CURRENT, pointer.to_bytes())
        return opened

    def named(self, name: str) -> Version:
        """The version of a name.

        Raises
        ------
        StoreError
            There is none of this name.
        """
        for path in self.versions():
            if path.name == name:
                return Version.open(path)
        there = ", ".join(path.name for path in self.versions()) or "none"
        raise StoreError(f"no version {name!r} in {self.path}; there is {there}")

    def before(self, version: Version) -> Version:
        """The newest version that is older than the given one.

        Raises
        ------
        StoreError
            There is none, or it cannot be opened.
        """
        older = [path for path in self.versions() if path.name < version.name]
        if not older:
            raise StoreError(
                f"{version.path} is the oldest version of {self.labels}; nothing came before it; "
                "see `roomtables status`"
            )
        return Version.open(older[-1])

    @contextmanager
    def staging(self) -> Iterator[Path]:
        """A folder to write a version aside in; whatever is left of it at the end is removed."""
        refuse_outside(self.path.parent, self.path)
        with writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
        folder = self.path / f"{STAGING}{os.getpid()}"
        try:
            with writing(folder):
                folder.mkdir()
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _others(self) -> str:
        names = sorted(path.parent.name for path in self.path.parent.glob(f"*/{CURRENT}"))
        return f" (there are tables for {', '.join(names)})" if names else ""
