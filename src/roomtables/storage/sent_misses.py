"""Misses on their way home: a robot sends its own to a place, a build takes in those of all robots.

::

    <url>/<label space>/misses/<robot>-<sha256>.jsonl    what a robot asked for since it last sent
    tables/<label space>/misses/fetched.json             where tables are built: what came
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from roomtables.errors import StoreError
from roomtables.limits import JSON_BYTES, MalformedError, json_value, read_bytes
from roomtables.storage.files import refuse_outside, write_aside
from roomtables.storage.miss_log import FILE_BYTES, FOLDER, FOLDER_BYTES, folder_bytes
from roomtables.storage.misses import FETCHED_PREFIX, SENT_NOTE, Miss, Misses
from roomtables.storage.origin import origin_of
from roomtables.storage.place import PATIENCE, Patience, Place, read_small, shown
from roomtables.storage.places import open_place
from roomtables.storage.versions import SpaceFolder

_NAME = re.compile(r"[\w-]{1,64}-([0-9a-f]{64})\.jsonl", re.ASCII)
_FETCHED = "fetched.json"
_MOST_KNOWN = 50_000  # names of files that came, before those that are gone are forgotten

log = logging.getLogger(__name__)


class SentMisses(NamedTuple):
    """What was sent: combinations, in so many files and bytes."""

    labels: str
    combinations: int
    files: int
    bytes: int


class FetchedMisses(NamedTuple):
    """What was fetched: files and bytes; and files that were skipped."""

    files: int
    bytes: int
    skipped: int


def send_misses(tables: Path, labels: str, url: str, patience: Patience = PATIENCE) -> SentMisses:
    """Send the misses noted here since the last time, each combination once, most asked first.

    They stay open for a build here. Where the tables were pulled, none will be made, and files that
    were sent and are no longer written to are removed.

    Raises
    ------
    StoreError
        Nothing is published, or the place cannot be written.
    """
    space, place = SpaceFolder(tables, labels), open_place(url, patience)
    version = space.current()
    misses = Misses.read(space.path / FOLDER, SENT_NOTE)
    robot = re.sub(r"[^\w-]", "_", os.uname().nodename, flags=re.ASCII)[:64] or "robot"
    sent = size = 0
    for content in _files(misses.open):
        name = f"{labels}/{FOLDER}/{robot}-{hashlib.sha256(content).hexdigest()}.jsonl"
        if place.size(name) != len(content):
            place.write(name, content)
            if read_small(place, name, FILE_BYTES) != content:
                raise StoreError(f"{shown(url)}/{name} is not what was sent; push again")
            sent, size = sent + 1, size + len(content)
    misses.take_in(remove=origin_of(version) is not None)
    return SentMisses(labels, len(misses.open), sent, size)


def _files(misses: Sequence[Miss]) -> Iterator[bytes]:
    """Their lines, in files of a bounded size."""
    content = b""
    for miss in misses:
        line = {"source": miss.source, "objects": miss.objects, "times": miss.times_asked}
        line |= {"asked": miss.last_asked.isoformat(timespec="seconds")}
        data = json.dumps(line).encode() + b"\n"
        if len(content) + len(data) > FILE_BYTES:
            yield content
            content = b""
        content += data
    if content:
        yield content


def fetch_misses(tables: Path, labels: str, url: str) -> FetchedMisses:
    """Bring the misses that robots sent to a place into this folder's; each file once.

    A file that is too large, cannot be read, or is not as its name says is skipped and named; so
    are lines that are no misses, by the build that reads them.

    Raises
    ------
    StoreError
        The place cannot be listed, or the tables folder not be written.
    """
    space, place = SpaceFolder(tables, labels), open_place(url)
    folder, where = space.path / FOLDER, f"{shown(url)}/{labels}/{FOLDER}"
    refuse_outside(tables, space.path, folder)
    listed = place.names(f"{labels}/{FOLDER}")
    before = _fetched(folder)
    # Those that are no longer there are forgotten when they are many, and the place is not empty.
    known = before & {*listed} if listed and len(before) > _MOST_KNOWN else {*before}
    files = size = skipped = 0
    if listed:
        folder.mkdir(parents=True, exist_ok=True)
    try:
        for name in (name for name in listed if name not in known):
            try:
                content = _content(place, f"{labels}/{FOLDER}/{name}", name)
            except (MalformedError, StoreError) as error:
                log.warning("%s/%s is skipped: %s", where, name, error)
                known |= {name} if isinstance(error, MalformedError) else set()  # it stays so
                skipped += 1
                continue
            if folder_bytes(folder) + len(content) > FOLDER_BYTES:
                log.warning("%s is full: the rest of %s waits for the next build", folder, where)
                break
            write_aside(folder / f"{FETCHED_PREFIX}{name}", content)
            known.add(name)
            files, size = files + 1, size + len(content)
    finally:
        if known != before:
            write_aside(folder / _FETCHED, json.dumps(sorted(known)).encode())
    return FetchedMisses(files, size, skipped)


def _content(place: Place, path: str, name: str) -> bytes:
    """A file as its name says.

    Raises
    ------
    MalformedError
        It is another.
    StoreError
        It cannot be read.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise MalformedError("it is no file of misses")
    if (place.size(path) or 0) > FILE_BYTES:
        raise MalformedError(f"it is larger than {FILE_BYTES >> 20} MB")
    content = read_small(place, path, FILE_BYTES)
    if hashlib.sha256(content).hexdigest() != found[1]:
        raise MalformedError("it is not as its name says")
    return content


def _fetched(folder: Path) -> set[str]:
    """The files that came from a place before; damaged: none, and what is known is read again."""
    try:
        value = json_value(read_bytes(folder / _FETCHED, JSON_BYTES))
    except (MalformedError, OSError, ValueError):
        return set()
    return {name for name in value if isinstance(name, str)} if isinstance(value, list) else set()
