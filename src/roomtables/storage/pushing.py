"""Push a published version to a place: its files, its index, and last the pointer.

::

    <url>/<label space>/CURRENT                the published version and its index's SHA-256
    <url>/<label space>/versions/<name>.json   its manifest, with every file's hash
    <url>/<label space>/CHECKED                when a build last found that version up to date
    <url>/<label space>/files/<sha256>         contents, shared by versions
"""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from roomtables.errors import StoreError
from roomtables.limits import JSON_BYTES
from roomtables.storage.checked import (
    CHECKED,
    LINE_BYTES,
    checked_line,
    last_checked,
    parse_checked,
)
from roomtables.storage.export import WriteModel
from roomtables.storage.files import held
from roomtables.storage.lookup import Lookup
from roomtables.storage.manifest import FileFacts, Manifest, ManifestError
from roomtables.storage.packed import Packed
from roomtables.storage.place import PATIENCE, MissingError, Patience, Place, read_small, shown
from roomtables.storage.places import open_place
from roomtables.storage.scratch import scratch
from roomtables.storage.versions import CURRENT, LOOKUP, NAME, Pointer, SpaceFolder, Version

VERSIONS = "versions"
FILES = "files"
KEPT_THERE = 3
SAFE_SECONDS = 3600.0  # what was written so lately stays: another push may be about to name it
_POINTER_BYTES = 400
_INDEX = re.compile(rf"{NAME.pattern}\.json")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Pushed:
    """What a push did: the version at the place, files and bytes sent, versions removed there."""

    labels: str
    version: str
    files: int
    bytes: int
    removed: int
    moved: bool


def push(
    tables: Path,
    labels: str,
    url: str,
    *,
    all_files: bool = False,
    write_model: WriteModel | None = None,
    keep: int = KEPT_THERE,
    patience: Patience = PATIENCE,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> Pushed:
    """Send the published version of a label space to a place; what is there is not sent again.

    ``progress`` is called with the bytes just sent or found there, and all that are needed.

    Raises
    ------
    StoreError
        Nothing is published, it is damaged, or the place cannot be written or fails.
    """
    version = SpaceFolder(tables, labels).current()
    version.verify()
    place = open_place(url, patience)
    with ExitStack() as stack:
        stack.enter_context(held(version.path))
        model = None
        if write_model is not None:
            model = stack.enter_context(scratch("push", tables))
            lookup = Lookup.open(version.path / LOOKUP, version.manifest, verify=True)
            write_model(version, lookup, model)
        packed = Packed.of(version, model, all_files)
        index = f"{labels}/{VERSIONS}/{packed.pointer.name}.json"
        # The index first: a push that removes old versions meanwhile then knows of these files.
        place.write(index, packed.manifest)
        sent = _send(place, labels, packed, url, progress)
        place.write(index, packed.manifest)
        moved = read_pointer(place, labels) != packed.pointer
        if moved:
            place.write(f"{labels}/{CURRENT}", packed.pointer.to_bytes())
        _send_checked(place, labels, version, packed)
        # What another push removed meanwhile.
        again = _send(place, labels, packed, url, lambda done, total: None)
    removed = remove_old_there(place, labels, keep)
    sent += again
    return Pushed(
        labels, packed.pointer.name, len(sent), sum(f.bytes for f in sent), removed, moved
    )


def _send_checked(place: Place, labels: str, version: Version, packed: Packed) -> None:
    """Let robots know when a build last found this version up to date."""
    moment = last_checked(version)
    if moment and moment != read_checked(place, labels, packed.pointer.name):
        place.write(f"{labels}/{CHECKED}", checked_line(packed.pointer.name, moment))


def read_checked(place: Place, labels: str, name: str) -> datetime | None:
    """When a build last found the version of a name up to date, as a place says; ``None`` where it
    does not say so of this one, or cannot be asked: then the tables are as old as their index says.
    """
    try:
        return parse_checked(read_small(place, f"{labels}/{CHECKED}", LINE_BYTES), name)
    except StoreError:
        return None


def read_pointer(place: Place, labels: str) -> Pointer | None:
    """What a place's ``CURRENT`` says; ``None`` where there is none.

    Raises
    ------
    StoreError
        It cannot be read, or is no pointer.
    """
    try:
        content = read_small(place, f"{labels}/{CURRENT}", _POINTER_BYTES)
    except MissingError:
        return None
    pointer = Pointer.parse(content.decode("ascii", "replace"))
    whole = len(pointer.sha256) == 64 and set(pointer.sha256) <= set("0123456789abcdef")
    # A name bears its index's hash, so that no two indexes are ever put into one folder.
    named = NAME.fullmatch(pointer.name) and pointer.name.endswith(pointer.sha256[:8])
    if not named or not whole:
        raise StoreError(f"{labels}/{CURRENT} of the place names no version; push again")
    return pointer


def _send(
    place: Place, labels: str, packed: Packed, url: str, progress: Callable[[int, int], object]
) -> list[FileFacts]:
    """Upload what is not there, and read it back; what was sent."""
    sent = {}
    needed = {facts.sha256: (name, facts) for name, facts in packed.files.items()}
    total = sum(facts.bytes for _, facts in needed.values())
    for name, facts in needed.values():
        there = f"{labels}/{FILES}/{facts.sha256}"
        if place.size(there) == facts.bytes:
            progress(facts.bytes, total)
            continue
        place.write(there, packed.places[name])
        digest = hashlib.sha256()
        for chunk in place.read(there):
            digest.update(chunk)
        if digest.hexdigest() != facts.sha256:
            raise StoreError(f"{shown(url)}/{there} is not what was sent; push again")
        sent[facts.sha256] = facts
        progress(facts.bytes, total)
    return list(sent.values())


def remove_old_there(place: Place, labels: str, keep: int) -> int:
    """Remove all but the newest versions of a place, the one that its pointer names, and what was
    written lately; then the files that no version needs. How many versions went."""
    found: dict[str, Manifest] = {}
    for name in place.names(f"{labels}/{VERSIONS}"):
        path = f"{labels}/{VERSIONS}/{name}"
        if not _INDEX.fullmatch(name):
            if place.age(path) >= SAFE_SECONDS:
                place.remove(path)  # left half written by a killed push
            continue
        try:
            content = read_small(place, path, JSON_BYTES)
            found[name.removesuffix(".json")] = Manifest.from_bytes(content)
        except MissingError:
            continue
        except (StoreError, ManifestError):
            log.warning("nothing old is removed: %s of the place cannot be read", path)
            return 0
    newest = sorted(found, key=lambda name: (found[name].created, name))
    removed = 0
    for name in newest[: -max(keep, 1)]:
        index = f"{labels}/{VERSIONS}/{name}.json"
        pointer = read_pointer(place, labels)
        if pointer is None or pointer.name == name or place.age(index) < SAFE_SECONDS:
            continue
        place.remove(index)
        del found[name]
        removed += 1
    pointer = read_pointer(place, labels)
    if pointer is None or pointer.name not in found:
        return removed
    needed = {facts.sha256 for manifest in found.values() for facts in manifest.files.values()}
    for name in place.names(f"{labels}/{FILES}"):
        path = f"{labels}/{FILES}/{name}"
        if name not in needed and place.age(path) >= SAFE_SECONDS:
            place.remove(path)
    return removed
