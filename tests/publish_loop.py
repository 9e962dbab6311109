"""Processes that open tables and classify while another publishes version after version.

Every version has a number, its generation, which decides all that it holds; so a reader can tell
whether what it opened is one version or a mixture of two. Run as a script for a longer look:
``python tests/publish_loop.py [SECONDS]``.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables import RoomTables
from roomtables.config import BuildConfig
from roomtables.labels import LabelSpace
from roomtables.storage.lookup import pack_keys
from roomtables.storage.lookup_writer import LookupSettings, ScoreChunks, write_lookup
from roomtables.storage.removal import remove_old
from roomtables.storage.versions import LOOKUP, SpaceFolder
from support import made_manifest

OBJECTS = ("bed", "lamp", "sink")
ROOMS = ("bathroom", "bedroom", "kitchen", "office", "yard")
READERS = 4
_PADDING = 60_000  # further rows, so that the files are large enough to be mapped


def publish(tables: Path, generation: int) -> None:
    """Publish a version that answers every combination with room number ``generation`` modulo 5.

    So do its scores of single objects; the bias holds the generation itself, and so does the
    manifest, as its number of sentences.
    """
    space = LabelSpace.named("loop", OBJECTS, ROOMS)
    folder = SpaceFolder(tables, space.name)
    built = BuildConfig()
    settings = LookupSettings(**{name: getattr(built, name) for name in LookupSettings._fields})
    with folder.staging() as staging:
        write_lookup(staging / LOOKUP, space, settings, {"proxy": _source(generation)})
        manifest = made_manifest(staging, labels=space.name, sentences=generation)
        folder.publish(staging, folder.new_name("generate"), manifest)
    remove_old(folder)


def _source(generation: int) -> tuple[dict[str, NDArray[Any]], ScoreChunks]:
    """What a lookup of a generation holds: its arrays, and the combinations' keys and scores."""
    room = generation % len(ROOMS)
    ranks = np.array([[1, 0, 0], [1, 2, 0], [1, 2, 3], [2, 0, 0], [3, 0, 0]])
    keys = np.concatenate(
        [np.sort(pack_keys(ranks, 3)), 2**62 + np.arange(_PADDING, dtype=np.uint64)]
    )
    scores = np.full((len(keys), len(ROOMS)), -50, np.float32)
    scores[:, room] = -10
    room_logits = np.full((len(OBJECTS), len(ROOMS)), -50.0)
    room_logits[:, room] = -10
    arrays: dict[str, NDArray[Any]] = {
        "entropy": np.array([0.1, 0.2, 0.3]),
        "ranks": np.array([1, 2, 3]),
        "room_logits": room_logits,
        "bias": np.full(len(ROOMS), float(generation)),
    }
    return arrays, ScoreChunks(len(keys), len(ROOMS), [(keys, scores)])


def read(tables: Path, ready: Any, stop: Any, results: Any) -> None:
    """Open and classify until ``stop`` is set.

    Puts into ``results``: how often it opened, how many generations it saw, what was wrong.
    """
    opens, seen, wrong = 0, set(), []
    ready.release()
    while not stop.is_set():
        try:
            opened = RoomTables.open(tables, "loop", offline=True, note_misses=False)
            generation = opened.version.manifest.sentences
            expected = ROOMS[generation % len(ROOMS)]
            found = {
                opened.deciding(rule=r).classify(["lamp", "bed"]).room for r in ("query", "pooled")
            }
            found |= set(opened.classify_many([["bed"], ["sink"], ["bed", "lamp", "sink"]]).rooms)
            seen.add(generation)
            bias = opened.lookup.sources["proxy"].bias
            if found != {expected} or set(bias.tolist()) != {float(generation)}:
                wrong.append(f"generation {generation}: {found}, bias {bias}")
        except Exception as error:
            wrong.append(f"{type(error).__name__}: {error}")
        opens += 1
    results.put((opens, len(seen), wrong[:3]))


def race(seconds: float) -> dict[str, Any]:
    """Publish for some seconds while ``READERS`` processes read; returns what they saw."""
    context = multiprocessing.get_context("spawn")
    ready, stop, results = context.Semaphore(0), context.Event(), context.Queue()
    with tempfile.TemporaryDirectory() as folder:
        tables = Path(folder)
        publish(tables, 0)
        work = (tables, ready, stop, results)
        readers = [context.Process(target=read, args=work) for _ in range(READERS)]
        for reader in readers:
            reader.start()
        for _ in readers:
            ready.acquire()
        published, until = 0, time.monotonic() + seconds
        while time.monotonic() < until:
            published += 1
            publish(tables, published)
        stop.set()
        found = [results.get() for _ in readers]
        for reader in readers:
            reader.join()
    return {
        "seconds": seconds,
        "published": published,
        "opens": sum(opens for opens, _, _ in found),
        "generations_seen": max(seen for _, seen, _ in found),
        "wrong": [what for _, _, wrong in found for what in wrong],
        "exit_codes": [reader.exitcode for reader in readers],
    }


if __name__ == "__main__":
    print(race(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0))
