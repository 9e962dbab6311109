"""Write a lookup twin: small arrays whole, scores in the chunks that they come in.

Memory holds one chunk at a time, whatever the number of combinations.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.twin import ARRAYS, INDEX, label_list, sampled_sha256

_SMALLEST = np.float16(2.0**-24)  # the smallest positive half-precision number
_LOWEST = np.finfo(np.float16).min


@dataclass(frozen=True)
class ScoreChunks:
    """Keys ``[n]``, ascending throughout, and scores ``[n, R⁺]``, in chunks of any size.

    Attributes
    ----------
    rows : how many combinations there are in all
    width : |R⁺|
    chunks : pairs of keys and scores
    half : write float16 distances to the row's maximum, and the maxima
    """

    rows: int
    width: int
    chunks: Iterable[tuple[NDArray[np.uint64], NDArray[np.float32]]]
    half: bool = False


def write_twin(
    folder: Path,
    labels: LabelSpace,
    settings: Mapping[str, Any],
    sources: Mapping[str, tuple[Mapping[str, NDArray[Any]], ScoreChunks]],
) -> dict[str, Any]:
    """Write a lookup folder: arrays first, the index that names and hashes them last.

    ``settings`` holds ``k``, ``template`` and ``reduction``; ``sources`` the small arrays by name
    and the scores, by source. Returns what the manifest has to say of the twin.

    Raises
    ------
    StoreError
        Keys do not ascend, or are not as many as announced.
    """
    folder.mkdir()
    index = {
        **settings,
        "objects": [[o.label, o.plural] for o in labels.objects],
        "rooms": [[r.label, r.article, r.predicted] for r in labels.rooms],
        "object_aliases": labels.object_aliases,
        "room_aliases": labels.room_aliases,
        "sources": {
            source: {name: _write_array(folder, source, name, arrays[name]) for name in arrays}
            | write_scores(folder, source, scores)
            for source, (arrays, scores) in sources.items()
        },
    }
    return write_index(folder, index)


def write_index(folder: Path, index: Mapping[str, Any]) -> dict[str, Any]:
    """Write ``lookup.json``; returns what the manifest has to say of the twin."""
    content = json.dumps(index, ensure_ascii=False).encode()
    (folder / INDEX).write_bytes(content)
    return {
        "lookup": {"sha256": hashlib.sha256(content).hexdigest()},
        "label_list": label_list(
            [label for label, _ in index["objects"]], [label for label, _, _ in index["rooms"]]
        ),
    }


def write_scores(folder: Path, source: str, scores: ScoreChunks) -> dict[str, dict[str, Any]]:
    """Write the files of keys and scores; returns their entries of the index by array.

    Raises
    ------
    StoreError
        Keys do not ascend, or are not as many as announced.
    """
    shapes: dict[str, tuple[int, ...]] = {"keys": (scores.rows,)}
    shapes["scores"] = (scores.rows, scores.width)
    dtypes = {"keys": "<u8", "scores": "<f4"}
    if scores.half:
        shapes["maxima"] = (scores.rows,)
        dtypes |= {"scores": "<f2", "maxima": "<f4"}
    paths = {name: folder / f"{source}.{name}.npy" for name in shapes}
    files = {name: path.open("wb") for name, path in paths.items()}
    try:
        for name, file in files.items():
            _write_header(file, dtypes[name], shapes[name])
        _append_chunks(source, scores, files)
    finally:
        for file in files.values():
            file.close()
    return {name: _entry(path, scores.rows) for name, path in paths.items()}


def halve(
    scores: NDArray[np.float32],
) -> tuple[NDArray[np.float16], NDArray[np.float32]]:
    """Scores ``[n, R⁺]`` as float16 distances to their row's maximum, and the maxima ``[n]``.

    Only the maximum itself becomes 0, so that no argmax is flipped.
    """
    maxima = scores.max(axis=1)
    distances = scores.astype(np.float64) - maxima[:, np.newaxis]
    halves = np.maximum(distances, float(_LOWEST)).astype(np.float16)
    return np.where(distances < 0, np.minimum(halves, -_SMALLEST), halves), maxima


def _append_chunks(source: str, scores: ScoreChunks, files: Mapping[str, BinaryIO]) -> None:
    rows, last = 0, -1
    for keys, values in scores.chunks:
        if len(keys) == 0:
            continue
        if int(keys[0]) <= last or not bool(np.all(keys[1:] > keys[:-1])):
            raise StoreError(
                f"query_scores of source {source} are not sorted by key; "
                "run `roomtables build --full-refresh`"
            )
        rows, last = rows + len(keys), int(keys[-1])
        arrays: dict[str, NDArray[Any]] = {"keys": keys, "scores": values}
        if scores.half:
            arrays["scores"], arrays["maxima"] = halve(values)
        for name, array in arrays.items():
            dtype = ARRAYS[name][0][1 if scores.half and name == "scores" else 0]
            files[name].write(np.ascontiguousarray(array, dtype=dtype).data)
    if rows != scores.rows:
        raise StoreError(
            f"query_scores of source {source} hold {rows} rows, not {scores.rows}; "
            "run `roomtables build --full-refresh`"
        )


def _write_header(file: BinaryIO, dtype: str, shape: tuple[int, ...]) -> None:
    np.lib.format.write_array_header_1_0(
        file, {"descr": dtype, "fortran_order": False, "shape": shape}
    )


def _write_array(folder: Path, source: str, name: str, array: NDArray[Any]) -> dict[str, Any]:
    path = folder / f"{source}.{name}.npy"
    np.save(path, np.ascontiguousarray(array, dtype=ARRAYS[name][0][0]), allow_pickle=False)
    return _entry(path, len(array))


def _entry(path: Path, rows: int) -> dict[str, Any]:
    """What the index says of a file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        return {
            "file": path.name,
            "bytes": size,
            "rows": rows,
            "sha256": hashlib.file_digest(file, "sha256").hexdigest(),
            "sample_sha256": sampled_sha256(file, size),
        }
