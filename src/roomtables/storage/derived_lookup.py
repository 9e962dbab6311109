"""The mapped lookup of a version, derived from the version's Parquet files in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roomtables.labels import LabelSpace
from roomtables.schemas import PROXY, parquet
from roomtables.storage.database import connect
from roomtables.storage.lookup_writer import LookupSettings, ScoreChunks, write_lookup
from roomtables.storage.versions import LOOKUP

_BATCH = 8192  # combinations in memory at once


def derive_lookup(version: Path, labels: LabelSpace, settings: LookupSettings) -> None:
    """Write ``lookup/`` of a version from its Parquet files, in bounded memory.

    Raises
    ------
    StoreError
        ``query_scores`` is not sorted by source and key.
    """
    rooms = [room.label for room in labels.predicted_rooms]
    scores = version / "query_scores.parquet"
    with connect() as connection:
        small = _SmallTables(connection, version)
        sources = {
            source: (small.arrays(source, labels), read_scores(scores, source, rooms))
            for source in small.sources()
        }
        write_lookup(version / LOOKUP, labels, settings, sources)


def read_scores(path: Path, source: str, rooms: list[str]) -> ScoreChunks:
    """One source's rows of a ``query_scores`` file, in its order, a batch at a time.

    ``rooms`` names the columns, in the order in which the scores are to be written.
    """
    rows = sum(len(batch) for batch in _batches(path, source, ["source"]))
    return ScoreChunks(rows, len(rooms), _chunks(path, source, rooms))


def _chunks(
    path: Path, source: str, rooms: list[str]
) -> Iterator[tuple[NDArray[np.uint64], NDArray[np.float32]]]:
    for batch in _batches(path, source, ["source", "key", *rooms]):
        columns = [batch.column(room).to_numpy(zero_copy_only=False) for room in rooms]
        keys = batch.column("key").to_numpy(zero_copy_only=False)
        yield keys, np.stack(columns, axis=1).astype(np.float32, copy=False)


def _batches(path: Path, source: str, columns: list[str]) -> Iterator[pa.RecordBatch]:
    with pq.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
        for batch in file.iter_batches(_BATCH, columns=columns, use_threads=False):
            chosen = batch.filter(pc.equal(batch.column("source"), source))
            if len(chosen):
                yield chosen


class _SmallTables:
    """The tables of a version that fit into memory, column by column."""

    def __init__(self, connection: duckdb.DuckDBPyConnection, version: Path) -> None:
        self._connection = connection
        self._version = version

    def sources(self) -> list[str]:
        return sorted({str(source) for source in self._column("source", "cooccurrence", "1")})

    def arrays(self, source: str, labels: LabelSpace) -> dict[str, NDArray[Any]]:
        """A source's small arrays, as :class:`~roomtables.storage.lookup.SourceArrays` has them."""
        log_p = "if(p_room_given_object > 0, ln(p_room_given_object), '-inf'::double)"
        logit = "score" if source == PROXY else log_p
        logits = self._column(logit, "cooccurrence", "object, room", source)
        return {
            "entropy": self._column("entropy_nats", "entropy", "object", source),
            "ranks": self._column("rank", "entropy", "object", source),
            "room_logits": logits.reshape(len(labels.objects), len(labels.rooms)),
            "bias": self._column("bias_nats", "room_bias", "room", source),
        }

    def _column(
        self, expression: str, table: str, order: str, source: str | None = None
    ) -> NDArray[Any]:
        """An expression over the rows of a source (of all: ``None``), in some order."""
        file = parquet(self._version / f"{table}.parquet")
        found = self._connection.execute(
            f"select {expression} from {file} where source = coalesce(?, source) order by {order}",
            [source],
        )
        (values,) = found.fetchnumpy().values()
        return np.asarray(values)
