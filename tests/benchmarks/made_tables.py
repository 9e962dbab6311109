"""Tables of a whole label space with made-up scores: as large as real ones, and made in a minute.

``query_scores.parquet`` is written as a build writes it; the mapped lookup is derived from it by
the build's own code. Speed and memory do not depend on what the scores are.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.config import BuildConfig, load_labels
from roomtables.labels import LabelSpace
from roomtables.offline.combinations import all_combinations
from roomtables.schemas import PROXY
from roomtables.storage.derived_lookup import read_scores
from roomtables.storage.lookup import pack_keys
from roomtables.storage.lookup_writer import LookupSettings, write_lookup
from roomtables.storage.versions import LOOKUP, SpaceFolder

sys.path.insert(0, str(Path(__file__).parents[1]))

from robot_tables import small_arrays
from support import made_manifest

_BUILT = BuildConfig(rule="query", source=PROXY, prior_weight=0.5, evidence_power=3.0)
K = _BUILT.k
_ROW_GROUP = 16384


def make(tables: Path, labels: str = "nyuclass", seed: int = 0) -> dict[str, Any]:
    """Publish made-up tables; returns rows, seconds and memory of deriving the lookup."""
    space = load_labels(labels)
    rng = np.random.default_rng(seed)
    room_logits = rng.normal(-30, 3, (len(space.objects), len(space.rooms)))
    folder = SpaceFolder(tables, space.name)
    with folder.staging() as staging:
        parquet = staging / "query_scores.parquet"
        rows = write_query_scores(parquet, space, rng)
        before, started = peak_mb(), time.perf_counter()
        scores = read_scores(parquet, PROXY, [room.label for room in space.predicted_rooms])
        small = small_arrays(room_logits, space)
        settings = LookupSettings(*(getattr(_BUILT, name) for name in LookupSettings._fields))
        write_lookup(staging / LOOKUP, space, settings, {PROXY: (small, scores)})
        seconds = time.perf_counter() - started
        manifest = made_manifest(
            staging, labels=space.name, settings=_BUILT, combinations={PROXY: rows}
        )
        folder.publish(staging, folder.new_name("madeupxx"), manifest)
    return {
        "rows": rows,
        "seconds": round(seconds, 2),
        "peak_mb_before": round(before),
        "peak_mb_after": round(peak_mb()),
    }


def write_query_scores(path: Path, space: LabelSpace, rng: np.random.Generator) -> int:
    """``query_scores`` of all combinations, sorted by key, in row groups as a build writes them."""
    ranks = all_combinations(len(space.objects), K)
    keys = np.sort(pack_keys(ranks, K))
    rooms = [room.label for room in space.predicted_rooms]
    fields = [("source", pa.string()), ("key", pa.uint64())]
    schema = pa.schema([*fields, *((room, pa.float32()) for room in rooms)])
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for start in range(0, len(keys), _ROW_GROUP):
            part = keys[start : start + _ROW_GROUP]
            values = rng.normal(-40, 4, (len(part), len(rooms))).astype(np.float32)
            source = pa.repeat(pa.scalar(PROXY), len(part))
            writer.write_table(pa.table([source, part, *values.T], schema=schema))
    return len(keys)


def peak_mb() -> float:
    """The most memory that this process has held, in megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
