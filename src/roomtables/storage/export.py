"""Pack what a robot needs of a published version into one archive: lookup files and manifest.

The archive holds ``tables/<label space>/``, with ``CURRENT`` last; unpacked, it opens like the
tables it came from, read-only file systems included.
"""

from __future__ import annotations

import gzip
import io
import os
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from roomtables.errors import InputError
from roomtables.storage.lookup import Lookup
from roomtables.storage.refusals import refusal
from roomtables.storage.versions import CURRENT, LOOKUP, MANIFEST, Pointer, SpaceFolder, Version

ROOT = "tables"
SUFFIXES = (".tar.zst", ".tar.gz", ".tar")


@dataclass(frozen=True)
class ExportedSource:
    """A source in an archive: its combinations, and the bytes of its files before compression."""

    source: str
    combinations: int
    rooms: int
    bytes: int


def export(tables: Path, labels: str, output: Path) -> tuple[ExportedSource, ...]:
    """Pack the published version of a label space; every byte of it is verified on the way.

    ``output`` is ``*.tar.zst``, ``*.tar.gz`` or ``*.tar``; written aside, then moved into place.

    Raises
    ------
    StoreError
        Nothing is published, it is damaged, or the archive cannot be written.
    InputError
        The output has another suffix.
    """
    if not output.name.endswith(SUFFIXES):
        raise InputError(f"{output}: name the archive *.tar.zst, *.tar.gz or *.tar")
    version = SpaceFolder(tables, labels).current()
    lookup = Lookup.open(version.path / LOOKUP, version.manifest, verify=True)
    try:
        with tempfile.TemporaryDirectory(dir=output.parent, prefix=f".{output.name}.") as folder:
            aside = Path(folder) / "archive"
            with _compressed(aside, output.name) as stream:
                _pack(stream, version)
            os.replace(aside, output)
    except OSError as error:
        raise refusal(error, output) or error from error
    return tuple(
        ExportedSource(source, len(arrays.keys), arrays.scores.shape[1], _bytes(version, source))
        for source, arrays in lookup.sources.items()
    )


def _bytes(version: Version, source: str) -> int:
    facts = version.manifest.files.items()
    return sum(fact.bytes for name, fact in facts if name.startswith(f"{LOOKUP}/{source}."))


def _pack(stream: IO[bytes], version: Version) -> None:
    space = f"{ROOT}/{version.manifest.labels}"
    inside = f"{space}/{version.name}"
    noted = version.manifest.files
    packed = {name: noted[name] for name in sorted(noted) if name.startswith(f"{LOOKUP}/")}
    manifest = replace(version.manifest, files=packed).to_bytes()
    pointer = Pointer(version.name, sha256(manifest).hexdigest())
    with tarfile.open(fileobj=stream, mode="w|") as archive:
        for name in packed:
            with (version.path / name).open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                _add(archive, version, f"{inside}/{name}", size, file)
        for place, content in (
            (f"{inside}/{MANIFEST}", manifest),
            (f"{space}/{CURRENT}", pointer.to_bytes()),
        ):
            _add(archive, version, place, len(content), io.BytesIO(content))


def _add(
    archive: tarfile.TarFile, version: Version, place: str, size: int, file: IO[bytes]
) -> None:
    """One member, with nothing of this machine in it: owner root, the version's own time."""
    member = tarfile.TarInfo(place)
    member.size = size
    member.mtime = int(version.manifest.created.timestamp())
    archive.addfile(member, file)


@contextmanager
def _compressed(path: Path, name: str) -> Iterator[Any]:
    """A stream to write the archive to, compressed as its name says."""
    if name.endswith(".zst"):
        import pyarrow as pa

        with pa.CompressedOutputStream(str(path), "zstd") as stream:
            yield stream
    elif name.endswith(".gz"):
        with path.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as zipped:
            yield zipped
    else:
        with path.open("wb") as raw:
            yield raw
