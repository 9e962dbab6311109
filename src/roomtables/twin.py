"""The lookup twin: what a decision needs of a published version, as memory-mapped arrays.

A folder ``lookup/`` holds ``lookup.json`` (labels, spellings, template, file list with sizes and
hashes) and, per source, arrays of a fixed layout. It is derived from the Parquet tables bit for
bit, and read with numpy alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel

INDEX = "lookup.json"
_ARRAYS: Mapping[str, tuple[str, int]] = {
    "entropy": ("<f8", 1),
    "ranks": ("<i4", 1),
    "object_room": ("<f8", 2),
    "bias": ("<f8", 1),
    "keys": ("<u8", 1),
    "scores": ("<f4", 2),
}


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
    """One source's arrays; objects and rooms in label order, R⁺ = predicted rooms.

    Attributes
    ----------
    entropy : ``[objects]``, nats
    ranks : ``[objects]``, 1 = most informative
    object_room : ``[objects, rooms]``, nats: S(o, r) of a proxy, log p(r | o) of counts
    bias : ``[R⁺]``, b in nats
    keys : ``[combinations]``, sorted
    scores : ``[combinations, R⁺]``, S of the query sentences, nats
    """

    entropy: NDArray[np.float64]
    ranks: NDArray[np.int32]
    object_room: NDArray[np.float64]
    bias: NDArray[np.float64]
    keys: NDArray[np.uint64]
    scores: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Twin:
    """An opened lookup folder."""

    objects: tuple[ObjectLabel, ...]
    rooms: tuple[RoomLabel, ...]
    object_aliases: Mapping[str, str]
    room_aliases: Mapping[str, str]
    k: int
    template: str
    reduction: str
    sources: Mapping[str, SourceArrays]

    @classmethod
    def open(cls, folder: Path) -> Twin:
        """Map the arrays of a lookup folder.

        Raises
        ------
        StoreError
            A file is missing, truncated, swapped for another, or not of the layout.
        """
        try:
            index = json.loads((folder / INDEX).read_bytes())
            sources = {
                source: SourceArrays(
                    **{name: _open_array(folder, files[name], name) for name in _ARRAYS}
                )
                for source, files in index["sources"].items()
            }
            return cls(
                tuple(ObjectLabel(label, plural) for label, plural in index["objects"]),
                tuple(RoomLabel(r, article, (), p) for r, article, p in index["rooms"]),
                index["object_aliases"],
                index["room_aliases"],
                index["k"],
                index["template"],
                index["reduction"],
                sources,
            )
        except OSError as error:
            raise StoreError(
                f"cannot read {error.filename or folder}: {error.strerror}; run `roomtables build`"
            ) from error
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(
                f"{folder} is damaged ({error}); run `roomtables build --full-refresh`"
            ) from error


def write_twin(
    folder: Path,
    labels: LabelSpace,
    settings: Mapping[str, Any],
    sources: Mapping[str, Mapping[str, NDArray[Any]]],
) -> None:
    """Write a lookup folder: arrays first, the index that names and hashes them last.

    ``settings`` holds ``k``, ``template`` and ``reduction``; ``sources`` the arrays by source.
    """
    folder.mkdir()
    listed = {
        source: {name: _write_array(folder, source, name, arrays[name]) for name in _ARRAYS}
        for source, arrays in sources.items()
    }
    index = {
        **settings,
        "objects": [[o.label, o.plural] for o in labels.objects],
        "rooms": [[r.label, r.article, r.predicted] for r in labels.rooms],
        "object_aliases": labels.object_aliases,
        "room_aliases": labels.room_aliases,
        "sources": listed,
    }
    (folder / INDEX).write_text(json.dumps(index, ensure_ascii=False), encoding="utf-8")


def _write_array(folder: Path, source: str, name: str, array: NDArray[Any]) -> dict[str, Any]:
    path = folder / f"{source}.{name}.npy"
    np.save(path, np.ascontiguousarray(array, dtype=_ARRAYS[name][0]), allow_pickle=False)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    size = path.stat().st_size
    return {"file": path.name, "bytes": size, "sha256": digest, "rows": len(array)}


def _open_array(folder: Path, listed: Mapping[str, Any], name: str) -> NDArray[Any]:
    path = folder / listed["file"]
    if path.stat().st_size != listed["bytes"]:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes, not {listed['bytes']}")
    mode: Literal["r"] | None = "r" if listed["rows"] else None  # nothing to map in an empty array
    array: NDArray[Any] = np.load(path, mmap_mode=mode, allow_pickle=False)
    if array.dtype.str != _ARRAYS[name][0] or array.ndim != _ARRAYS[name][1]:
        raise ValueError(f"{path.name} is not an array of {_ARRAYS[name][0]}")
    return array


def unpack_ranks(keys: NDArray[np.uint64], k: int) -> NDArray[np.int64]:
    """Ranks ``[n, k]`` of keys ``[n]``; 0 behind the last object."""
    bits = key_bits(k)
    mask = np.uint64((1 << bits) - 1)
    columns: Sequence[NDArray[np.uint64]] = [
        (keys >> np.uint64(bits * (k - 1 - column))) & mask for column in range(k)
    ]
    return np.stack(columns, axis=1).astype(np.int64)
