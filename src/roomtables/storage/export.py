"""Pack what a robot needs of a published version into one archive: lookup files and manifest.

The archive holds ``tables/<label space>/``, with ``CURRENT`` last; unpacked, it opens like the
tables it came from, read-only file systems included.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import InputError, StoreError
from roomtables.storage.lookup import INDEX, Lookup, SourceArrays
from roomtables.storage.lookup_writer import ScoreChunks, write_index, write_scores
from roomtables.storage.versions import CURRENT, LOOKUP, MANIFEST, SpaceFolder, Version, file_facts

ROOT = "tables"
SUFFIXES = (".tar.zst", ".tar.gz", ".tar")
_CHUNK = 16384


@dataclass(frozen=True)
class ExportedSource:
    """A source in an archive: its combinations, and the bytes of its files before compression."""

    source: str
    combinations: int
    rooms: int
    bytes: int


def export(
    tables: Path, labels: str, output: Path, float16: bool = False
) -> tuple[ExportedSource, ...]:
    """Pack the published version of a label space; every byte of it is verified on the way.

    Parameters
    ----------
    output : ``*.tar.zst``, ``*.tar.gz`` or ``*.tar``; written aside, then moved into place
    float16 : scores as half-precision distances to their row's maximum, and the maxima; the best
        room of no combination changes

    Raises
    ------
    StoreError
        Nothing is published, it is damaged, or the archive cannot be written.
    InputError
        The output has another suffix.
    """
    if not output.name.endswith(SUFFIXES):
        raise InputError(f"{output}: name the archive *.tar.zst, *.tar.gz or *.tar")
    space = SpaceFolder(tables, labels)
    version = space.current()
    lookup = Lookup.open(version.path / LOOKUP, version.manifest, verify=True)
    try:
        with tempfile.TemporaryDirectory(dir=output.parent, prefix=f".{output.name}.") as folder:
            made = Path(folder)
            index, manifest = _contents(version, lookup, made, float16)
            aside = made / "archive"
            with _compressed(aside, output.name) as stream:
                _pack(stream, version, made, index, manifest)
            os.replace(aside, output)
    except OSError as error:
        raise StoreError(
            f"cannot write {output}: {error.strerror or error}; give another path with -o"
        ) from error
    return tuple(
        ExportedSource(
            source,
            files["keys"]["rows"],
            lookup.sources[source].scores.shape[1],
            sum(entry["bytes"] for entry in files.values()),
        )
        for source, files in index["sources"].items()
    )


def _contents(
    version: Version, lookup: Lookup, made: Path, float16: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The index and the manifest of the archive; what differs from the version is in ``made``."""
    index = json.loads((version.path / LOOKUP / INDEX).read_bytes())
    for source, arrays in lookup.sources.items():
        if float16 and arrays.maxima is None:
            chunks = ScoreChunks(
                len(arrays.keys), arrays.scores.shape[1], _chunks(arrays), half=True
            )
            index["sources"][source] |= write_scores(made, source, chunks)
    manifest = dict(version.manifest) | write_index(made, index)
    manifest["files"] = {
        f"{LOOKUP}/{name}": file_facts(_find(version, made, name)) for name in _names(index)
    }
    return index, manifest


def _chunks(
    arrays: SourceArrays,
) -> Iterator[tuple[NDArray[np.uint64], NDArray[np.float32]]]:
    for start in range(0, len(arrays.keys), _CHUNK):
        rows = slice(start, start + _CHUNK)
        yield arrays.keys[rows], np.asarray(arrays.scores[rows], np.float32)


def _names(index: Mapping[str, Any]) -> list[str]:
    files = (entry for source in index["sources"].values() for entry in source.values())
    return sorted([INDEX, *(entry["file"] for entry in files)])


def _find(version: Version, made: Path, name: str) -> Path:
    return made / name if (made / name).exists() else version.path / LOOKUP / name


def _pack(
    stream: IO[bytes],
    version: Version,
    made: Path,
    index: Mapping[str, Any],
    manifest: Mapping[str, Any],
) -> None:
    space = f"{ROOT}/{version.manifest['labels']}"
    inside = f"{space}/{version.name}"
    text = json.dumps(manifest, indent=2, sort_keys=True, ensure_ascii=False)
    with tarfile.open(fileobj=stream, mode="w|") as archive:
        for name in _names(index):
            path = _find(version, made, name)
            with path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                _add(archive, version, f"{inside}/{LOOKUP}/{name}", size, file)
        for place, content in (
            (f"{inside}/{MANIFEST}", text.encode()),
            (f"{space}/{CURRENT}", f"{version.name}\n".encode()),
        ):
            _add(archive, version, place, len(content), io.BytesIO(content))


def _add(
    archive: tarfile.TarFile, version: Version, place: str, size: int, file: IO[bytes]
) -> None:
    """One member, with nothing of this machine in it: owner root, the version's own time."""
    member = tarfile.TarInfo(place)
    member.size = size
    member.mtime = int(version.created.timestamp())
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
