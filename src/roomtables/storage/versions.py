"""Published versions on disk: found through ``CURRENT``, written aside, moved into place.

::

    tables/<label space>/CURRENT            names the published version
    tables/<label space>/<version>/manifest.json, *.parquet, lookup/

A reader opens through ``CURRENT`` once and keeps what it opened; a writer never touches a published
file. This module needs no pyarrow and no duckdb.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from roomtables.errors import StoreError
from roomtables.schemas import SCHEMA_VERSION
from roomtables.storage.files import check_name, is_held, refuse_outside, writing

MANIFEST = "manifest.json"
CURRENT = "CURRENT"
LOOKUP = "lookup"
KEPT_VERSIONS = 2
_STAGING = ".staging-"


def write_aside(path: Path, data: bytes) -> None:
    """Replace a file atomically: a reader sees the old content or the new, never a part."""
    aside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with aside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise StoreError(f"cannot write {path}: {error.strerror}") from error


def file_facts(path: Path) -> dict[str, Any]:
    """Size and SHA-256 of a file, as a manifest notes them."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"bytes": path.stat().st_size, "sha256": digest}


class _Manifest(dict[str, Any]):
    """What a manifest holds; a key that it lacks is damage, and said to be."""

    def __init__(self, content: Mapping[str, Any], path: Path) -> None:
        super().__init__(content)
        self._path = path

    def __missing__(self, key: str) -> Any:
        raise StoreError(
            f"{self._path} is damaged: it lacks {key!r}; run `roomtables build --full-refresh`"
        )


@dataclass(frozen=True)
class Version:
    """One published version: its folder and its manifest."""

    path: Path
    manifest: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def created(self) -> datetime:
        """When the version was published, in UTC."""
        return datetime.fromisoformat(self.manifest["created"])

    def verify(self) -> None:
        """Compare every file with the size and the hash that the manifest notes.

        Raises
        ------
        StoreError
            A file is missing, cut, or has a bit flipped; the message names it.
        """
        for name, noted in self.manifest.get("files", {}).items():
            path = self.path / name
            if not path.is_file() or file_facts(path) != noted:
                raise StoreError(f"{path} is damaged; run `roomtables build` to make it again")

    @classmethod
    def open(cls, path: Path) -> Version:
        """The version in a folder.

        Raises
        ------
        StoreError
            Its manifest is missing, damaged, or of another schema version.
        """
        manifest_path = path / MANIFEST
        refuse_outside(path.parent.parent, path, manifest_path, path / LOOKUP)
        try:
            manifest = json.loads(manifest_path.read_bytes())
            schema_version = manifest["schema_version"]
        except OSError as error:
            raise StoreError(
                f"cannot read {manifest_path}: {error.strerror}; run `roomtables build`"
            ) from error
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(
                f"{manifest_path} is damaged; run `roomtables build --full-refresh`"
            ) from error
        if schema_version != SCHEMA_VERSION:
            raise StoreError(
                f"{path} has schema version {schema_version}, this roomtables reads "
                f"{SCHEMA_VERSION}; run `roomtables build`"
            )
        return cls(path, _Manifest(manifest, manifest_path))


class SpaceFolder:
    """The versions of one label space under a tables folder."""

    def __init__(self, tables: Path, labels: str) -> None:
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
            name = pointer.read_text(encoding="utf-8").strip()
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
        return Version.open(version)

    def pointer(self) -> bytes:
        """What ``CURRENT`` says now; nothing where there is none."""
        try:
            return (self.path / CURRENT).read_bytes()
        except OSError:
            return b""

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
        return sorted(path.parent for path in self.path.glob(f"[!.]*/{MANIFEST}"))

    def new_name(self, fingerprint: str) -> str:
        """A name for the next version: a number, which no clock can turn back, and its inputs."""
        numbers = [int(n) for path in self.versions() if (n := path.name.split("-")[0]).isdigit()]
        return f"{max(numbers, default=0) + 1:06d}-{fingerprint[:8]}"

    def publish(self, staging: Path, name: str, manifest: Mapping[str, Any]) -> Version:
        """Write the manifest, move the staged folder into place, and point ``CURRENT`` at it."""
        target = self.path / name
        if target.exists():
            raise StoreError(f"{target} exists already; run `roomtables gc`, then build again")
        text = json.dumps(manifest, indent=2, sort_keys=True, ensure_ascii=False)
        write_aside(staging / MANIFEST, text.encode())
        with writing(target):
            os.replace(staging, target)
        return self.point_at(target)

    def point_at(self, version: Path) -> Version:
        """Make a version the published one."""
        write_aside(self.path / CURRENT, f"{version.name}\n".encode())
        return Version.open(version)

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
        folder = self.path / f"{_STAGING}{os.getpid()}"
        try:
            with writing(folder):
                folder.mkdir()
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def remove_abandoned(self) -> None:
        """Remove what a killed build was writing aside; only for whoever holds the build lock."""
        refuse_outside(self.path.parent, self.path)
        for abandoned in self.path.glob(f"{_STAGING}*"):
            shutil.rmtree(abandoned, ignore_errors=True)

    def remove_old(self, keep: int = KEPT_VERSIONS) -> list[str]:
        """Remove all but the newest versions, the current one, and those that a reader holds.

        Returns the names of those removed. A manifest goes first: what is half removed is no
        version any more.
        """
        current = self.published()
        removed = []
        for path in self.versions()[: -max(keep, 1)]:
            kept = current is not None and path == current.path
            if not kept and not path.is_symlink() and not is_held(path):
                with writing(path):
                    (path / MANIFEST).unlink()
                    shutil.rmtree(path)
                removed.append(path.name)
        return removed

    def _others(self) -> str:
        names = sorted(path.parent.name for path in self.path.parent.glob(f"*/{CURRENT}"))
        return f" (there are tables for {', '.join(names)})" if names else ""
