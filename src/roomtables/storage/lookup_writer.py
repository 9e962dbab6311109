"""Write the mapped lookup of a version: small arrays whole, scores in the chunks they come in.

Memory holds one chunk at a time, whatever the number of combinations.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.schemas import PROXY, parquet
from roomtables.storage.database import connect
from roomtables.storage.lookup import ARRAYS, INDEX, sampled_sha256
from roomtables.storage.manifest import FileFacts
from roomtables.storage.versions import LOOKUP

_BATCH = 8192  # combinations in memory at once


class LookupSettings(NamedTuple):
    """The settings of a build that whoever looks up has to know.

    How a sentence about a combination that is not there would read and be scored, and how a room is
    decided where nothing else is said.
    """

    k: int
    template: tuple[str, ...]
    reduction: str
    source: str
    rule: str
    prior_weight: float
    evidence_power: float


@dataclass(frozen=True)
class ScoreChunks:
    """Keys ``[n]``, ascending throughout, and scores ``[n, R⁺]``, in chunks of any size.

    Attributes
    ----------
    rows : how many combinations there are in all
    width : |R⁺|
    chunks : pairs of keys and scores
    """

    rows: int
    width: int
    chunks: Iterable[tuple[NDArray[np.uint64], NDArray[np.float32]]]


Sources = Mapping[str, tuple[Mapping[str, NDArray[Any]], ScoreChunks]]


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


def write_lookup(
    folder: Path, labels: LabelSpace, settings: LookupSettings, sources: Sources
) -> None:
    """Write a lookup folder: arrays first, the index that names and hashes them last.

    ``sources`` holds, by source, the small arrays by name and the scores.

    Raises
    ------
    StoreError
        Keys do not ascend, or are not as many as announced.
    """
    folder.mkdir()
    index = settings._asdict() | {
        "objects": [[o.label, o.plural] for o in labels.objects],
        "rooms": [[r.label, r.article, r.predicted] for r in labels.rooms],
        "score_rooms": [room.label for room in labels.predicted_rooms],
        "object_aliases": labels.object_aliases,
        "room_aliases": labels.room_aliases,
        "sources": {
            source: {name: _write_array(folder, source, name, arrays[name]) for name in arrays}
            | _write_scores(folder, source, scores)
            for source, (arrays, scores) in sources.items()
        },
    }
    (folder / INDEX).write_bytes(json.dumps(index, ensure_ascii=False).encode())


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


def _write_scores(folder: Path, source: str, scores: ScoreChunks) -> dict[str, dict[str, Any]]:
    """Write the files of keys and scores; returns their entries of the index by array."""
    shapes = {"keys": (scores.rows,), "scores": (scores.rows, scores.width)}
    paths = {name: folder / f"{source}.{name}.npy" for name in shapes}
    with paths["keys"].open("wb") as keys, paths["scores"].open("wb") as values:
        _write_header(keys, ARRAYS["keys"][0], shapes["keys"])
        _write_header(values, ARRAYS["scores"][0], shapes["scores"])
        _append_chunks(source, scores, keys, values)
    return {name: _entry(path, scores.rows) for name, path in paths.items()}


def _append_chunks(
    source: str, scores: ScoreChunks, key_file: BinaryIO, score_file: BinaryIO
) -> None:
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
        key_file.write(np.ascontiguousarray(keys, dtype=ARRAYS["keys"][0]).data)
        score_file.write(np.ascontiguousarray(values, dtype=ARRAYS["scores"][0]).data)
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
    np.save(path, np.ascontiguousarray(array, dtype=ARRAYS[name][0]), allow_pickle=False)
    return _entry(path, len(array))


def _entry(path: Path, rows: int) -> dict[str, Any]:
    """What the index says of a file."""
    facts = FileFacts.of(path)
    with path.open("rb") as file:
        sample = sampled_sha256(file, facts.bytes)
    return {"file": path.name, "rows": rows, **asdict(facts), "sample_sha256": sample}
