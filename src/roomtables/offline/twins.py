"""Derive the lookup twin of a version from its tables, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roomtables.labels import LabelSpace
from roomtables.schemas import PROXY
from roomtables.twin_writer import ScoreChunks, write_twin

_BATCH = 8192  # combinations in memory at once


def derive_twin(
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
    return write_twin(folder, labels, settings, sources)


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
    object_room = _column(
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
        "object_room": object_room.reshape(len(labels.objects), len(labels.rooms)),
        "bias": bias if len(bias) else np.zeros(len(labels.predicted_rooms)),
    }


def _column(connection: duckdb.DuckDBPyConnection, query: str, source: str) -> NDArray[Any]:
    """The one column of a query, as an array."""
    (values,) = connection.execute(query, [source]).fetchnumpy().values()
    return np.asarray(values)
