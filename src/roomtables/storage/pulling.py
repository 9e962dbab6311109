"""Pull the version that a place's pointer names: fetch what is new, verify every byte, switch.

The pointer names the index's hash, the index the hash of every file: nothing that a place holds is
taken on trust of its name. What a cut pull has fetched lies in ``.pulling-files`` of the label
space's folder, by hash, for the next one to go on with.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from roomtables.errors import StoreError
from roomtables.limits import JSON_BYTES
from roomtables.storage.checked import note_checked
from roomtables.storage.client_databases import write_anew
from roomtables.storage.files import build_lock, refuse_links, utc_now, write_aside, writing
from roomtables.storage.lookup import Lookup
from roomtables.storage.manifest import FileFacts, Manifest, ManifestError
from roomtables.storage.origin import note_origin
from roomtables.storage.place import PATIENCE, Patience, Place, read_small, shown
from roomtables.storage.places import open_place
from roomtables.storage.pushing import FILES, VERSIONS, read_checked, read_pointer
from roomtables.storage.removal import remove_left, remove_old
from roomtables.storage.versions import LOOKUP, Pointer, SpaceFolder, Version

FETCHED = ".pulling-files"
_ATTEMPTS = 3
_SHAPES = re.compile(
    r"(lookup|model|labels)/[A-Za-z0-9_][A-Za-z0-9_.-]{0,200}"
    r"|[a-z_]{1,60}\.parquet|samples\.json"
)
_HASH = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Pulled:
    """What a pull did: the version here now, whether it is new, files and bytes."""

    labels: str
    version: str
    new: bool
    files: int
    bytes_fetched: int
    bytes_here: int


def pull(
    tables: Path,
    labels: str,
    url: str,
    progress: Callable[[int, int], object] = lambda done, total: None,
    patience: Patience = PATIENCE,
) -> Pulled:
    """Make the version that a place's pointer names the published one.

    ``progress`` is called with the bytes just fetched or found here, and all that are needed.

    Raises
    ------
    StoreError
        The place has no tables of this label space, fails, or holds what is not as its hashes say;
        or there is no room for them here. What is published here stays.
    """
    space, place = SpaceFolder(tables, labels), open_place(url, patience)
    pointer = read_pointer(place, labels)
    if pointer is None:
        raise StoreError(
            f"no tables for {labels} at {shown(url)}; name others with `--labels`, or run "
            "`roomtables push` to that place where they are built"
        )
    checked = read_checked(place, labels, pointer.name)
    if _is_here(space, pointer):
        with build_lock(tables, wait=True):  # for another pull, which ends in bounded time
            _settle(space, url, checked)
        return Pulled(labels, pointer.name, False, 0, 0, 0)
    content, manifest = _index(place, labels, pointer, url)
    with build_lock(tables, wait=True):
        space.path.mkdir(exist_ok=True)
        needed = {facts.sha256: facts for facts in manifest.files.values()}
        total = sum(facts.bytes for facts in needed.values())
        job = _Fetching(place, space, url, lambda done: progress(done, total))
        job.remove_others(needed)
        job.check_room(needed.values())
        found = {digest: job.fetch(facts) for digest, facts in needed.items()}
        _publish(space, pointer, content, manifest, found)
        _settle(space, url, checked)
    return Pulled(labels, pointer.name, True, len(manifest.files), job.fetched, job.here)


def _settle(space: SpaceFolder, url: str, checked: datetime | None) -> None:
    """What follows a switch, and a pull that finds nothing new: one before may have been killed."""
    version = space.current()
    note_origin(version, shown(url), utc_now())
    if checked is not None:
        note_checked(version, checked)
    remove_left(space)
    remove_old(space)
    write_anew(space.path.parent)


def _is_here(space: SpaceFolder, pointer: Pointer) -> bool:
    """Whether the pointer's version is published here, and every byte of it as written."""
    version = space.published() if Pointer.parse(_text(space.pointer())) == pointer else None
    return version is not None and not any(version.damaged_files())


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def _index(place: Place, labels: str, pointer: Pointer, url: str) -> tuple[bytes, Manifest]:
    """A version's index, its hash as the pointer says, its names of the known shapes."""
    name = f"{labels}/{VERSIONS}/{pointer.name}.json"
    content = read_small(place, name, JSON_BYTES)
    where = f"{shown(url)}/{name}"
    if hashlib.sha256(content).hexdigest() != pointer.sha256:
        raise StoreError(f"{where} is not the one that the pointer names; push again")
    try:
        manifest = Manifest.from_bytes(content)
    except ManifestError as error:
        raise StoreError(f"{where} is of no use here: {error}") from error
    for path, facts in manifest.files.items():
        if not _SHAPES.fullmatch(path) or not _HASH.fullmatch(facts.sha256):
            raise StoreError(f"{where} names {path[:60]!r}, which is no file of tables")
    if manifest.labels != labels:
        raise StoreError(f"{where} holds tables of {manifest.labels[:60]!r}, not {labels}")
    return content, manifest


class _Fetching:
    """Files by hash, from what is here already or from the place."""

    def __init__(
        self, place: Place, space: SpaceFolder, url: str, progress: Callable[[int], object]
    ) -> None:
        self._place, self._space, self._url, self._progress = place, space, url, progress
        self._folder = space.path / FETCHED
        refuse_links(space.path, self._folder)
        with writing(self._folder):
            self._folder.mkdir(exist_ok=True)
        self._local: dict[str, Path] = {}
        for path in space.versions():
            try:
                files = Version.open(path).manifest.files
            except StoreError:
                continue
            self._local |= {facts.sha256: path / name for name, facts in files.items()}
        self.fetched = self.here = 0

    def remove_others(self, needed: Container[str]) -> None:
        """Remove what was fetched of a version that the place names no more."""
        with writing(self._folder):
            for path in self._folder.iterdir():
                if path.name not in needed:
                    path.unlink()

    def check_room(self, needed: Iterable[FileFacts]) -> None:
        """Refuse to fetch what cannot fit.

        Raises
        ------
        StoreError
            There are fewer bytes free than are to be fetched.
        """
        size = sum(facts.bytes - self._held(facts) for facts in needed)
        free = shutil.disk_usage(self._folder).free
        if size > free:
            raise StoreError(
                f"{shown(self._url)} has {size / 1e6:,.1f} MB to fetch, and {free / 1e6:,.1f} MB "
                f"are free at {self._space.path}; make room, then pull again"
            )

    def _held(self, facts: FileFacts) -> int:
        """The bytes of a file that are here."""
        if facts.sha256 in self._local:
            return facts.bytes
        part = self._folder / facts.sha256
        return min(part.stat().st_size, facts.bytes) if part.is_file() else 0

    def fetch(self, facts: FileFacts) -> Path:
        """A file with this content, verified."""
        path, local = self._folder / facts.sha256, self._local.get(facts.sha256)
        refuse_links(path)
        with writing(path):
            for found in (path, local):
                if found and found.is_file() and FileFacts.of(found) == facts:
                    self.here += facts.bytes
                    self._progress(facts.bytes)
                    return found
            for attempt in range(_ATTEMPTS):
                before = self.fetched
                try:
                    self._append(path, facts)
                except StoreError:
                    if attempt == _ATTEMPTS - 1 or self.fetched == before:
                        raise
                    continue  # it was cut, and the next attempt goes on from there
                if FileFacts.of(path) == facts:
                    return path
                if path.stat().st_size >= facts.bytes:
                    path.unlink()  # wrong bytes: anew from the first one
        raise StoreError(
            f"{shown(self._url)}/{self._space.labels}/{FILES}/{facts.sha256} is cut or is not the "
            "file of this hash; remove it there, then push again where the tables are built"
        )

    def _append(self, path: Path, facts: FileFacts) -> None:
        """Go on with a file where it was cut, up to the bytes that the index says."""
        start = path.stat().st_size if path.exists() else 0
        left = facts.bytes - start
        name = f"{self._space.labels}/{FILES}/{facts.sha256}"
        with path.open("ab") as file:
            if left > 0:
                for chunk in self._place.read(name, start):
                    file.write(chunk[:left])
                    got = min(left, len(chunk))
                    left -= got
                    self.fetched += got
                    self._progress(got)
                    if not left:
                        break


def _publish(
    space: SpaceFolder,
    pointer: Pointer,
    content: bytes,
    manifest: Manifest,
    found: dict[str, Path],
) -> Version:
    """Put a version together aside, check it, move it into place and point ``CURRENT`` at it."""
    target = space.path / pointer.name
    with space.staging() as staging, writing(staging):
        for name, facts in manifest.files.items():
            (staging / name).parent.mkdir(exist_ok=True)
            _link(found[facts.sha256], staging / name)
        write_aside(staging / "manifest.json", content)
        Version.open(staging, pointer.sha256).verify()
        Lookup.open(staging / LOOKUP, manifest, verify=True)
        if not target.exists():
            return space.publish(staging, pointer.name, manifest)
        # It is here, not published or damaged: each damaged file is replaced by the right one.
        write_aside(target / "manifest.json", content)
        for name, _ in list(Version.open(target, pointer.sha256).damaged_files()):
            (target / name).parent.mkdir(exist_ok=True)
            os.replace(staging / name, target / name)
        return space.point_at(target)


def _link(source: Path, target: Path) -> None:
    """The same content under another name; a copy where the file system has no links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
