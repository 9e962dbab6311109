"""A robot's first answers and its unseen rooms: the model in ONNX beside the model in torch.

    python tests/benchmarks/robot.py [--labels mpcat40 --labels household] [--tables DIR]

Makes tables of household-lm that hold 200 combinations of three objects (in a folder that is
reused if it is there), and asks for those and for others. Seconds and milliseconds of the
processor are those of all threads. Prints a table for each label space.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from roomtables import RoomTables, build
from roomtables.config import builtin_labels, load_labels
from roomtables.lm import load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.onnx_lm import OnnxScorer
from roomtables.scorer import Scorer

HELD = 200
BATCH = 100
# The peak of this process alone: ru_maxrss would take over that of the process it was forked from.
FIRST_ANSWER = """
import sys, time
from roomtables import RoomTables
{scorer}
tables = RoomTables.open(sys.argv[1], sys.argv[2], rule="query", note_misses=False, **options)
answer = tables.classify(sys.argv[3:])
assert answer.answered_by == "{by}", answer
peak, = (line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(time.process_time(), int(peak.split()[1]) / 1024)
"""
NO_MODEL = "options = {'offline': True}"
AS_INSTALLED = "options = {}"
TORCH = "from roomtables.lm import load_scorer\noptions = {'scorer': load_scorer()}"


def start(body: str, arguments: Sequence[str], runs: int) -> tuple[float, float, float]:
    """Median seconds of the clock and of the processor, and megabytes, of a process to its end."""
    found = []
    for _ in range(runs + 1):
        started = time.perf_counter()
        command = [sys.executable, "-c", body, *arguments]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        seconds = time.perf_counter() - started
        found.append((seconds, *map(float, done.stdout.split())))
    clock, processor, megabytes = np.median(found[1:], axis=0).tolist()
    return clock, processor, megabytes


def processor_ms(call: Callable[[], object]) -> float:
    """Milliseconds of the processor that a call takes."""
    started = time.process_time()
    call()
    return 1000 * (time.process_time() - started)


def unseen(
    scorers: dict[str, Scorer], tables: Path, labels: str, rooms: list[list[str]], alone: int
) -> dict[str, tuple[float, float]]:
    """Per scorer: milliseconds per unseen room alone (median), and in batches of 100 (best of 3).

    The scorers take turns.
    """
    options: dict[str, Any] = {"rule": "query", "note_misses": False}
    opened = {
        name: RoomTables.open(tables, labels, scorer=scorer, **options)
        for name, scorer in scorers.items()
    }
    single: dict[str, list[float]] = {name: [] for name in scorers}
    for room in rooms[:alone]:
        for name, table in opened.items():
            single[name].append(processor_ms(lambda table=table, room=room: table.classify(room)))  # type: ignore[misc]
    many: dict[str, list[float]] = {name: [] for name in scorers}
    for begin in range(alone, alone + 3 * BATCH, BATCH):
        asked = rooms[begin : begin + BATCH]
        for name, table in opened.items():
            took = processor_ms(lambda table=table, asked=asked: table.classify_many(asked))  # type: ignore[misc]
            many[name].append(took / BATCH)
    return {name: (float(np.median(single[name])), min(many[name])) for name in scorers}


def hits(tables: Path, labels: str, rooms: list[list[str]]) -> tuple[float, float]:
    """Milliseconds of the processor per room in the tables, alone (median) and in a batch."""
    opened = RoomTables.open(tables, labels, rule="query", offline=True)
    assert all(p.answered_by == "table" for p in opened.classify_many(rooms))
    single = [processor_ms(lambda room=room: opened.classify(room)) for room in rooms * 20]  # type: ignore[misc]
    batch = min(processor_ms(lambda: opened.classify_many(rooms * 100)) for _ in range(5))
    return float(np.median(single)), batch / len(rooms) / 100


def combinations(labels: str, count: int) -> list[list[str]]:
    """Distinct combinations of three objects of a label space, always the same."""
    rng = random.Random(0)
    names = [label.label for label in load_labels(labels).objects]
    found: dict[frozenset[str], list[str]] = {}
    while len(found) < count:
        drawn = rng.sample(names, 3)
        found[frozenset(drawn)] = drawn
    return list(found.values())


def make_tables(tables: Path, labels: str, held: list[list[str]]) -> None:
    """Tables that hold some combinations, unless they are there."""
    if (tables / labels / "CURRENT").exists():
        return
    tables.mkdir(parents=True, exist_ok=True)
    log = tables / f"{labels}.jsonl"
    lines = [json.dumps({"room_id": str(at), "objects": room}) for at, room in enumerate(held)]
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    build(tables=tables, labels=labels, combinations=str(log), device="cpu")


def run(tables: Path, labels: str, runs: int, alone: int) -> None:
    """Measure one label space, and print it."""
    rooms = combinations(labels, HELD + alone + 3 * BATCH + 1)
    held, others = rooms[:HELD], rooms[HELD:]
    make_tables(tables, labels, held)
    space = load_labels(labels)
    print(f"\n{labels}: {len(space.objects):,} objects, {len(space.predicted_rooms)} rooms")
    of_table, of_model = ([str(tables), labels, *room] for room in (held[0], others[-1]))
    starts = {
        "start to first room, table": start(
            FIRST_ANSWER.format(scorer=NO_MODEL, by="table"), of_table, runs
        ),
        "start to first unseen room, ONNX": start(
            FIRST_ANSWER.format(scorer=AS_INSTALLED, by="lm"), of_model, runs
        ),
        "start to first unseen room, torch": start(
            FIRST_ANSWER.format(scorer=TORCH, by="lm"), of_model, runs
        ),
    }
    rows = [[what, *measured] for what, measured in starts.items()]
    print(tabulate(rows, ["", "s", "s of CPU", "MB, peak"], floatfmt=("", ".2f", ".2f", ".0f")))
    print()
    scorers: dict[str, Scorer] = {
        "ONNX": OnnxScorer.open(EMBEDDED_FOLDER), "torch": load_scorer()
    }  # fmt: skip
    found = unseen(scorers, tables, labels, others, alone)
    per_room = [[f"unseen room, {name}", *measured] for name, measured in found.items()]
    per_room.append(["room in the table", *hits(tables, labels, held)])
    heads = ["", "alone, ms of CPU", f"in batches of {BATCH}"]
    print(tabulate(per_room, heads, floatfmt=("", ".4g", ".4g")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=Path)
    parser.add_argument("--labels", action="append")
    parser.add_argument("--runs", type=int, default=5, help="processes, after one that is unseen")
    parser.add_argument("--alone", type=int, default=100, help="unseen rooms asked one by one")
    options = parser.parse_args()
    spaces = options.labels or [n for n in ("mpcat40", "household") if n in builtin_labels()]
    with tempfile.TemporaryDirectory() as folder:
        for labels in spaces:
            run(options.tables or Path(folder), labels, options.runs, options.alone)


if __name__ == "__main__":
    main()
