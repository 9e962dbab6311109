"""Write a mapped lookup: small arrays whole, scores in the chunks that they come in.

Memory holds one chunk at a time, whatever the number of combinations.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.schemas import PROXY
from roomtables.storage.lookup import ARRAYS, INDEX, label_list, sampled_sha256

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


def write_lookup(
    folder: Path,
    labels: LabelSpace,
    settings: Mapping[str, Any],
    sources: Mapping[str, tuple[Mapping[str, NDArray[Any]], ScoreChunks]],
) -> dict[str, Any]:
    """Write a lookup folder: arrays first, the index that names and hashes them last.

    ``settings`` holds ``k``, ``template`` and ``reduction``; ``sources`` the small arrays by name
    and the scores, by source. Returns what the manifest has to say of the lookup.

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
    """Write ``lookup.json``; returns what the manifest has to say of the lookup."""
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


_BATCH = 8192  # combinations in memory at once


def derive_lookup(
    connection: duckdb.DuckDBPyConnection,
    version: Path,
    folder: Path,
    labels: LabelSpace,
    settings: Mapping[str, Any],
) -> dict[str, Any]:
    """Write ``lookup/`` of a version; returns what its manifest has to say of it.

    The small tables come from the connection, the scores from the version's Parquet file, as it
    was written: sorted by source and key.

    Raises
    ------
    StoreError
        ``query_scores`` is not sorted by key.
    """
    found = connection.execute("select distinct source from cooccurrence order by source")
    width = len(labels.predicted_rooms)
    sources = {
        source: (
            _small_arrays(connection, source, labels),
            read_scores(version / "query_scores.parquet", source, width),
        )
        for (source,) in found.fetchall()
    }
    return write_lookup(folder, labels, settings, sources)


def read_scores(path: Path, source: str, width: int) -> ScoreChunks:
    """One source's rows of a ``query_scores`` file, in its order, a batch at a time."""
    rows = sum(len(batch) for batch in _batches(path, source, ["source"]))
    return ScoreChunks(rows, width, _chunks(path, source, width))


def _chunks(
    path: Path, source: str, width: int
) -> Iterator[tuple[NDArray[np.uint64], NDArray[np.float32]]]:
    for batch in _batches(path, source, ["source", "key", "scores"]):
        scores = batch.column("scores").flatten().to_numpy(zero_copy_only=False)
        keys = batch.column("key").to_numpy(zero_copy_only=False)
        yield keys, scores.astype(np.float32, copy=False).reshape(-1, width)


def _batches(path: Path, source: str, columns: list[str]) -> Iterator[pa.RecordBatch]:
    with pq.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
        for batch in file.iter_batches(_BATCH, columns=columns, use_threads=False):
            chosen = batch.filter(pc.equal(batch.column("source"), source))
            if len(chosen):
                yield chosen


def _small_arrays(
    connection: duckdb.DuckDBPyConnection, source: str, labels: LabelSpace
) -> dict[str, NDArray[Any]]:
    evidence = "score" if source == PROXY else "ln(p_room_given_object)"
    room_logits = _column(
        connection,
        f"select case when p_room_given_object > 0 then {evidence} else '-inf'::double end "
        "from cooccurrence where source = ? order by object, room",
        source,
    )
    # Compared as numbers; the tables hold each room's bias once, whatever the source.
    bias = _column(
        connection, "select bias_nats from room_bias where source = ? order by room", source
    )
    return {
        "entropy": _column(
            connection, "select entropy_nats from entropy where source = ? order by object", source
        ),
        "ranks": _column(
            connection, "select rank from entropy where source = ? order by object", source
        ),
        "room_logits": room_logits.reshape(len(labels.objects), len(labels.rooms)),
        "bias": bias if len(bias) else np.zeros(len(labels.predicted_rooms)),
    }


def _column(connection: duckdb.DuckDBPyConnection, query: str, source: str) -> NDArray[Any]:
    """The one column of a query, as an array."""
    (values,) = connection.execute(query, [source]).fetchnumpy().values()
    return np.asarray(values)
