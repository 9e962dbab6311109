"""The mapped lookup: what a decision needs of a published version, as memory-mapped arrays.

A folder ``lookup/`` holds ``lookup.json`` (labels, names, templates, which room each column of
scores is, and the array files with their sizes and hashes) and, per source, arrays of a fixed
layout. It is read with numpy alone.

What an open verifies: the hash of ``lookup.json`` against the manifest; the whole content of small
arrays; of large ones the size, the header, and pages sampled throughout. That finds a truncated
file and one swapped for another. Flipped bits between the sampled pages are found by
``verify=True``, which reads everything.
"""

from __future__ import annotations

import hashlib
import io
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError, first_line
from roomtables.labels import (
    LABEL,
    PLURAL,
    SYNONYM,
    Name,
    ObjectLabel,
    RoomLabel,
    normalise,
)
from roomtables.limits import JSON_BYTES, json_value, read_bytes
from roomtables.schemas import SENTENCE
from roomtables.storage.files import sha256_of
from roomtables.storage.manifest import Manifest

INDEX = "lookup.json"
# Arrays by name: dtype, and number of dimensions.
ARRAYS: Mapping[str, tuple[str, int]] = {
    "entropy": ("<f8", 1),
    "ranks": ("<i4", 1),
    "room_logits": ("<f8", 2),
    "bias": ("<f8", 1),
    "keys": ("<u8", 1),
    "scores": ("<f4", 2),
}

SMALL_BYTES = 1 << 20  # bytes of a file that is read and hashed whole on every open
_PAGE = 4096
_LONGEST_NAME = 255  # of a file
_SAMPLED_PAGES = 32
_BEYOND_MEMORY = 1 << 30  # bytes of a file for which the system shall not read ahead


def key_bits(k: int) -> int:
    """Bits of a key that one of its ``k`` objects takes (21 for k = 3)."""
    return 63 // k


def pack_keys(ranks: NDArray[np.int64], k: int) -> NDArray[np.uint64]:
    """Keys of combinations: ranks ``[n, k]``, ascending, 0 behind the last object → ``[n]``."""
    keys = np.zeros(len(ranks), np.uint64)
    for column in range(k):
        keys = (keys << np.uint64(key_bits(k))) | ranks[:, column].astype(np.uint64)
    return keys


@dataclass(frozen=True, slots=True)
class SourceArrays:
    """One source's arrays; objects and rooms in label order, R⁺ = predicted rooms in label order.

    Attributes
    ----------
    entropy : ``[objects]``, nats
    ranks : ``[objects]``, 1 = most informative
    room_logits : ``[objects, rooms]``, nats: what L is the log softmax of; S(o, r) of a proxy,
        log p(r | o) of counts
    bias : ``[R⁺]``, b in nats
    keys : ``[combinations]``, sorted
    scores : ``[combinations, R⁺]``, nats: S of the query sentences
    """

    entropy: NDArray[np.float64]
    ranks: NDArray[np.int32]
    room_logits: NDArray[np.float64]
    bias: NDArray[np.float64]
    keys: NDArray[np.uint64]
    scores: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Lookup:
    """An opened lookup folder.

    Attributes
    ----------
    object_aliases, room_aliases : every name that is read as it stands, normalised → its label
    k : objects in a combination at most
    template : the wordings of the sentences; the query sentence has the first
    scored : which tokens of a sentence count, of :data:`roomtables.schemas.SCORED`
    """

    objects: tuple[ObjectLabel, ...]
    rooms: tuple[RoomLabel, ...]
    object_aliases: Mapping[str, str]
    room_aliases: Mapping[str, str]
    k: int
    template: tuple[str, ...]
    scored: str
    reduction: str
    sources: Mapping[str, SourceArrays]

    def object_names(self) -> dict[str, Name]:
        """Every name of an object that is read as it stands, and how: table ``names``.

        The plural or singular of a synonym counts as a synonym here.
        """
        plurals = {normalise(listed.plural) for listed in self.objects}
        return {
            name: Name(label, LABEL if name == label else PLURAL if name in plurals else SYNONYM)
            for name, label in self.object_aliases.items()
        }

    @classmethod
    def open(cls, folder: Path, manifest: Manifest, verify: bool = False) -> Lookup:
        """Map the arrays of a lookup folder.

        Parameters
        ----------
        folder : the lookup folder of a version
        manifest : the version's manifest, which holds the hash of the index
        verify : read and hash every byte

        Raises
        ------
        StoreError
            A file is missing, truncated, swapped for another, or not of the layout.
        """
        try:
            return cls._open(folder, manifest, verify)
        except OSError as error:
            raise StoreError(
                f"cannot read {error.filename or folder}: {error.strerror}; run `roomtables build`"
            ) from error
        except (
            ArithmeticError,
            AttributeError,
            EOFError,
            LookupError,
            TypeError,
            ValueError,
        ) as error:
            raise StoreError(
                f"{folder} is damaged ({first_line(error)}); run `roomtables build --full-refresh`"
            ) from error

    @classmethod
    def _open(cls, folder: Path, manifest: Manifest, verify: bool) -> Lookup:
        content = read_bytes(folder / INDEX, JSON_BYTES)
        noted = manifest.files[f"{folder.name}/{INDEX}"]
        if hashlib.sha256(content).hexdigest() != noted.sha256:
            raise ValueError(f"{INDEX} is not the one that the manifest names")
        index = json_value(content)
        objects = tuple(ObjectLabel(label, plural) for label, plural in index["objects"])
        rooms = tuple(RoomLabel(r, article, (), p) for r, article, p in index["rooms"])
        columns = [room.label for room in rooms if room.predicted]
        if index["score_rooms"] != columns:
            raise ValueError(f"{INDEX} does not name its columns of scores in label order")
        shape = (len(objects), len(rooms), len(columns))
        return cls(
            objects,
            rooms,
            index["object_aliases"],
            index["room_aliases"],
            index["k"],
            tuple(index["template"]),
            index.get("scored", SENTENCE),  # older lookups do not say
            index["reduction"],
            {
                source: _open_source(folder, files, shape, verify)
                for source, files in index["sources"].items()
            },
        )


def sampled_sha256(file: BinaryIO, size: int) -> str:
    """SHA-256 of pages spread evenly over a file, its first and last among them."""
    digest = hashlib.sha256()
    last = max(size - _PAGE, 0)
    for sample in range(_SAMPLED_PAGES):
        digest.update(os.pread(file.fileno(), _PAGE, last * sample // (_SAMPLED_PAGES - 1)))
    return digest.hexdigest()


def _open_source(
    folder: Path, files: Mapping[str, Any], shape: tuple[int, int, int], verify: bool
) -> SourceArrays:
    arrays = {name: _open_array(folder, files[name], name, verify) for name in ARRAYS}
    found = SourceArrays(**arrays)
    objects, rooms, predicted = shape
    fits = (
        len(found.entropy) == len(found.ranks) == objects
        and found.room_logits.shape == (objects, rooms)
        and len(found.bias) == predicted
        and found.scores.shape == (len(found.keys), predicted)
    )
    if not fits:
        raise ValueError("its arrays do not fit each other or the labels")
    return found


def _open_array(folder: Path, listed: Mapping[str, Any], name: str, verify: bool) -> NDArray[Any]:
    file_name: str = listed["file"]
    if Path(file_name).name != file_name or len(file_name) > _LONGEST_NAME:
        raise ValueError(f"{file_name[:40]!r} is no file of its own")
    path = folder / file_name
    size: int = listed["bytes"]
    array: NDArray[Any] | None = None
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size != size:
            raise ValueError(f"{path.name} has not the {size} bytes that it was written with")
        if size <= SMALL_BYTES:
            content = file.read()
            if hashlib.sha256(content).hexdigest() == listed["sha256"]:
                array = np.load(io.BytesIO(content), allow_pickle=False)
        else:
            good = sampled_sha256(file, size) == listed["sample_sha256"]
            if good and verify:
                good = sha256_of(file) == listed["sha256"]
            if good:
                array = _map(file, size)
    if array is None:
        raise ValueError(f"{path.name} is not the file that it was written as")
    if (array.dtype.str, array.ndim) != ARRAYS[name]:
        raise ValueError(f"{path.name} is not an array of {ARRAYS[name][0]}")
    return array


def _map(file: BinaryIO, size: int) -> NDArray[Any]:
    """A read-only array over the file's pages; it outlives the file's removal."""
    file.seek(0)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError(f"{file.name} is not of .npy format 1.0")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if fortran or dtype.hasobject:
        raise ValueError(f"{file.name} is not a plain array")
    pages = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if size > _BEYOND_MEMORY and hasattr(mmap, "MADV_RANDOM"):
        pages.madvise(mmap.MADV_RANDOM)
    array: NDArray[Any] = np.frombuffer(pages, dtype, offset=file.tell()).reshape(shape)
    return array
