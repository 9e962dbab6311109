"""Look rooms up in 1.35 million combinations and more: roomtables against its peers, in one run.

    python tests/benchmarks/lookup.py [--tables DIR] [--rooms 20000]

Made-up tables of `nyuclass`, k = 3 (see made_tables.py), in a folder that is reused if it is there.
The peers only fetch the scores by key; roomtables goes from strings to a label. Prints a table.
"""

from __future__ import annotations

import argparse
import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import duckdb
import made_tables
import numpy as np
from tabulate import tabulate

from roomtables import RoomTables
from roomtables.storage.lookup import pack_keys

LABELS = "nyuclass"
BATCH = 100_000
# The peak of this process alone: ru_maxrss would take over that of the process it was forked from.
START = """
import sys
{body}
peak, = (line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024)
"""
FIRST_ANSWER = """
from roomtables import RoomTables
RoomTables.open(sys.argv[1], "nyuclass", offline=True).classify(["bed", "lamp", "pillow"]).room
"""
TENSORS = "import torch\nfrom transformers import AutoModelForCausalLM, AutoTokenizer"


def p50_us(fetch: Callable[[object], object], asked: Sequence[object]) -> float:
    """Median microseconds of a call, each on its own question, when all were asked once before."""
    for _ in range(2):
        times = []
        for one in asked:
            started = time.perf_counter_ns()
            fetch(one)
            times.append(time.perf_counter_ns() - started)
    return float(np.median(times)) / 1000


def peers(
    tables: RoomTables, folder: Path
) -> dict[str, tuple[Callable[[object], object], Callable[[np.ndarray], object] | None]]:
    """Name → fetch the scores of one key, and of an array of keys."""
    arrays = tables.lookup.sources["proxy"]
    keys, scores = np.asarray(arrays.keys), np.asarray(arrays.scores)
    database = duckdb.connect(str(folder / "lookup.duckdb"))
    columns = ", ".join(f"r{n} float" for n in range(scores.shape[1]))
    database.execute(f"create table t (key ubigint primary key, {columns})")
    frame = {"key": keys} | {f"r{n}": scores[:, n] for n in range(scores.shape[1])}
    import pyarrow as pa

    batch = pa.table(frame)
    database.register("batch", batch)
    database.execute("insert into t select * from batch")
    database.unregister("batch")
    database.execute("prepare by_key as select * from t where key = ?")

    light = sqlite3.connect(folder / "lookup.sqlite")
    light.execute("create table t (key integer primary key, scores blob) without rowid")
    light.executemany("insert into t values (?, ?)", _blobs(keys, scores))
    light.commit()
    held = dict(zip(keys.tolist(), (row.tobytes() for row in scores), strict=True))

    def duckdb_batch(wanted: np.ndarray) -> object:
        asked = pa.table({"key": wanted})
        database.register("asked", asked)
        return database.execute("select t.* from asked join t using (key)").fetchnumpy()

    found = {
        "DuckDB, prepared": (
            lambda key: database.execute(f"execute by_key({key})").fetchone(),
            duckdb_batch,
        ),
        "SQLite": (
            lambda key: light.execute("select scores from t where key = ?", (key,)).fetchone(),
            None,
        ),
        "dict of bytes": (lambda key: held[key], None),
    }
    return found | _lmdb(keys, scores, folder)  # type: ignore[operator]


def _lmdb(keys: np.ndarray, scores: np.ndarray, folder: Path) -> dict[str, object]:
    try:
        import lmdb
    except ImportError:
        print("lmdb is not installed, so it is left out", file=sys.stderr)
        return {}
    store = lmdb.open(str(folder / "lookup.lmdb"), map_size=1 << 31)
    with store.begin(write=True) as writing:
        for key, blob in _blobs(keys, scores):
            writing.put(key.to_bytes(8, "big"), blob, append=True)
    reading = store.begin(buffers=True)
    return {"LMDB": (lambda key: reading.get(key.to_bytes(8, "big")), None)}


def _blobs(keys: np.ndarray, scores: np.ndarray) -> Sequence[tuple[int, bytes]]:
    return list(zip(keys.tolist(), (row.tobytes() for row in scores), strict=True))


def starts(bodies: Sequence[str], tables: Path) -> list[tuple[float, float]]:
    """Median seconds and megabytes of processes that run the bodies, in turn, after one unseen."""
    seconds: list[list[float]] = [[] for _ in bodies]
    megabytes: list[list[float]] = [[] for _ in bodies]
    for turn in range(6):
        for at, body in enumerate(bodies):
            command = [sys.executable, "-c", START.format(body=body), str(tables)]
            started = time.perf_counter()
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            if turn:
                seconds[at].append(time.perf_counter() - started)
                megabytes[at].append(float(done.stdout))
    return [
        (float(np.median(s)), float(np.median(m))) for s, m in zip(seconds, megabytes, strict=True)
    ]


def questions(tables: RoomTables, count: int) -> list[list[str]]:
    """Rooms of 4 to 12 objects."""
    rng = random.Random(0)
    names = [o.label for o in tables.lookup.objects]
    return [rng.sample(names, rng.randint(4, 12)) for _ in range(count)]


def keys_of(tables: RoomTables, rooms: list[list[str]]) -> np.ndarray:
    """The keys that the rooms' best objects have, for the peers."""
    ranks = dict(
        zip(
            (o.label for o in tables.lookup.objects),
            tables.lookup.sources["proxy"].ranks.tolist(),
            strict=True,
        )
    )
    best = [sorted(ranks[name] for name in room)[: tables.lookup.k] for room in rooms]
    return pack_keys(np.array(best), tables.lookup.k)


def batch_rate(classify: Callable[[], object], count: int) -> tuple[float, float]:
    """The best of five: per second of the clock, and of the processor."""
    wall, cpu = [], []
    for _ in range(5):
        clock, processor = time.perf_counter(), time.process_time()
        classify()
        wall.append(time.perf_counter() - clock)
        cpu.append(time.process_time() - processor)
    return count / min(wall), count / min(cpu)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=Path)
    parser.add_argument("--rooms", type=int, default=20_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = options.tables or Path(folder) / "tables"
        if not (root / LABELS / "CURRENT").exists():
            print("lookup from query_scores:", made_tables.make(root, LABELS))
        run_start(root)
        run(root, Path(folder), options.rooms)


def run_start(root: Path) -> None:
    """Print how long and how large a process is up to its first answer."""
    lookup, tensors = starts([FIRST_ANSWER, TENSORS], root)
    print(f"start to first answer: {lookup[0] * 1000:.0f} ms, {lookup[1]:.0f} MB")
    print(
        f"start to torch and transformers imported: {tensors[0] * 1000:.0f} ms, {tensors[1]:.0f} MB"
    )
    print(f"ratio: {tensors[0] / lookup[0]:.1f}x faster, {tensors[1] / lookup[1]:.1f}x less memory")


def run(root: Path, folder: Path, count: int) -> None:
    """Print one room, and many rooms."""
    tables = RoomTables.open(root, LABELS, offline=True)
    rooms = questions(tables, BATCH)
    keys = keys_of(tables, rooms)
    print(f"{len(tables.lookup.sources['proxy'].keys):,} combinations; rooms of 4 to 12 objects")
    rows: list[list[object]] = []
    others = peers(tables, folder)
    single = {name: p50_us(one, keys[:2000].tolist()) for name, (one, _) in others.items()}
    reference = single["DuckDB, prepared"]
    for rule in ("query", "calibrated", "pooled"):
        opened = tables.deciding(rule=rule)
        mine = p50_us(opened.classify, rooms[:count])  # type: ignore[arg-type]
        wall, cpu = batch_rate(lambda opened=opened: opened.classify_many(rooms), BATCH)  # type: ignore[misc]
        rows.append([f"roomtables, {rule}", mine, reference / mine, wall, cpu])
    for name, (_, many) in others.items():
        rates = batch_rate(lambda many=many: many(keys), BATCH) if many else ("", "")  # type: ignore[misc]
        rows.append([name, single[name], reference / single[name], *rates])
    heads = ["", "p50 us/room", "x DuckDB", "batch rooms/s", "per cpu second"]
    print(tabulate(rows, heads, floatfmt=(None, ".2f", ".1f", ",.0f", ",.0f")))


if __name__ == "__main__":
    main()
