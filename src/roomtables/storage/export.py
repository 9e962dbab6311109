"""Pack what a robot needs of a published version: lookup files, manifest, and perhaps a model.

The archive holds ``tables/<label space>/``, with ``CURRENT`` last; unpacked, it opens like the
tables it came from, read-only file systems included. The version's folder is named after what it
holds, too: an archive that is unpacked over another leaves what that one holds as it is.
"""

from __future__ import annotations

import gzip
import io
import os
import tarfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from roomtables.errors import InputError, needing
from roomtables.storage.aside import replacing
from roomtables.storage.lookup import Lookup
from roomtables.storage.packed import Packed
from roomtables.storage.refusals import refusal
from roomtables.storage.scratch import scratch
from roomtables.storage.versions import CURRENT, LOOKUP, MANIFEST, SpaceFolder, Version

ROOT = "tables"
SUFFIXES = (".tar.zst", ".tar.gz", ".tar")


@dataclass(frozen=True)
class ExportedSource:
    """A source in an archive: its combinations, and the bytes of its files before compression."""

    source: str
    combinations: int
    rooms: int
    bytes: int


WriteModel = Callable[[Version, Lookup, Path], None]
"""Writes the model that scored a version's query sentences into a folder, as ONNX Runtime reads it.
"""


def export(
    tables: Path, labels: str, output: Path, write_model: WriteModel | None = None
) -> tuple[ExportedSource, ...]:
    """Pack the published version of a label space; every byte of it is verified on the way.

    ``output`` is ``*.tar.zst``, ``*.tar.gz`` or ``*.tar``; written aside, then moved into place.
    What ``write_model`` writes becomes the version's folder ``model``; what it raises leaves
    nothing behind.

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
        with ExitStack() as stack:
            model = None
            if write_model is not None:
                model = stack.enter_context(scratch("export", output.parent))
                write_model(version, lookup, model)
            aside = stack.enter_context(replacing(output))
            _pack(stack.enter_context(_compressed(aside, output.name)), version, model)
    except OSError as error:
        raise refusal(error, output) or error from error
    return tuple(
        ExportedSource(source, len(arrays.keys), arrays.scores.shape[1], _bytes(version, source))
        for source, arrays in lookup.sources.items()
    )


def _bytes(version: Version, source: str) -> int:
    facts = version.manifest.files.items()
    return sum(fact.bytes for name, fact in facts if name.startswith(f"{LOOKUP}/{source}."))


def _pack(stream: IO[bytes], version: Version, model: Path | None) -> None:
    space = f"{ROOT}/{version.manifest.labels}"
    packed = Packed.of(version, model)
    inside = f"{space}/{packed.pointer.name}"
    with tarfile.open(fileobj=stream, mode="w|") as archive:
        for name, path in packed.places.items():
            with path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                _add(archive, version, f"{inside}/{name}", size, file)
        for place, content in (
            (f"{inside}/{MANIFEST}", packed.manifest),
            (f"{space}/{CURRENT}", packed.pointer.to_bytes()),
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
        with needing("an archive *.tar.zst (*.tar.gz needs nothing)"):
            import pyarrow as pa

        with pa.CompressedOutputStream(str(path), "zstd") as stream:
            yield stream
    elif name.endswith(".gz"):
        with path.open("wb") as raw, gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as zipped:
            yield zipped
    else:
        with path.open("wb") as raw:
            yield raw
