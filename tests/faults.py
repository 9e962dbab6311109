"""Kill builds at random moments and check what must hold: `python tests/faults.py --kills 50`.

A child process builds (or compacts, or collects garbage) with a slow scorer; the parent kills it
with SIGKILL at a random moment, checks the folder, and goes on in the same folder. All the while a
reader opens the published version again and again.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import duckdb

from roomtables import build
from roomtables.labels import LabelSpace
from roomtables.offline import scoring, upkeep
from roomtables.storage.lookup import Lookup
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, write_space

SPACE = LabelSpace.named("home", [f"thing{n}" for n in range(10)], [f"place{n}" for n in range(5)])
# What a child may be told to do: how many objects make a combination, and which model scores.
JOBS = ((1, "hash@1"), (2, "hash@1"), (3, "hash@1"), (2, "hash@2"))


class SlowScorer(HashScorer):
    """Takes its time, so that a kill meets it at work."""

    def __init__(self, name: str, seconds: float) -> None:
        super().__init__(name)
        self.seconds = seconds

    def score_stream(self, sentences):
        for score in super().score_stream(sentences):
            time.sleep(self.seconds)
            yield score


def child(tables: Path, labels: str, action: str, k: int, scorer: str, seconds: float) -> None:
    """Do one thing, after saying that everything is imported."""
    scoring.PART_SENTENCES = 50
    print("ready", flush=True)
    if action == "compact":
        upkeep.compact(tables)
    elif action == "gc":
        upkeep.collect_garbage(tables)
    else:
        refresh = action == "refresh"
        model = SlowScorer(scorer, seconds)
        build(tables=tables, labels=labels, k=k, scorer=model, full_refresh=refresh)


def digest(tables: Path) -> tuple[tuple[int, str], str]:
    """What the published version says it is, and a hash of what a lookup of it holds."""
    version = SpaceFolder(tables, SPACE.name).current()
    lookup = Lookup.open(version.path / "lookup", version.manifest)
    arrays = lookup.sources["proxy"]
    content = hashlib.sha256()
    # Entropies are sums, and the order of their terms is DuckDB's: equal to a tolerance only.
    for array in (arrays.keys, arrays.scores, arrays.entropy.round(9), arrays.ranks):
        content.update(array.tobytes())
    return (version.manifest["k"], version.manifest["scorer_id"]), content.hexdigest()


@dataclass
class Reader(threading.Thread):
    """Opens the published version all the while; every look must be one of the expected."""

    tables: Path
    expected: dict[tuple[int, str], str]
    looks: int = 0
    failures: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(daemon=True)
        self.ended = threading.Event()

    def __hash__(self) -> int:
        return id(self)

    def run(self) -> None:
        while not self.ended.wait(0.005):
            try:
                job, content = digest(self.tables)
            except Exception as error:
                self.failures.append(repr(error))
                continue
            if self.expected[job] != content:
                self.failures.append(f"{job} is mixed")
            self.looks += 1


def rows(tables: Path, scorer: str) -> list[tuple[Any, ...]]:
    """All sentence scores of a model, sorted."""
    select = SentenceCache(tables, scorer).select()
    return duckdb.connect().execute(f"from ({select}) order by all").fetchall()


def check_folder(tables: Path) -> None:
    """What holds at any moment: whole parts, each sentence at most once."""
    for folder in sorted((tables / "scores").glob("*")):
        SentenceCache(tables, folder.name).verify()
        sentences = [row[1] for row in rows(tables, folder.name)]
        assert len(sentences) == len(set(sentences)), f"{folder} holds a sentence twice"


def run_faults(root: Path, kills: int, seed: int, seconds: float = 0.0005) -> dict[str, int]:
    """Kill ``kills`` children, let every fifth one's work be finished, compare with undisturbed.

    Returns how many children were killed, how many builds were compared, how often was read.
    """
    dice = random.Random(seed)
    labels = str(write_space(root / "labels", SPACE))
    expected = {}
    undisturbed = {}
    for k, scorer in JOBS:
        build(tables=root / f"clean-{k}-{scorer}", labels=labels, k=k, scorer=HashScorer(scorer))
        expected[(k, scorer)] = digest(root / f"clean-{k}-{scorer}")[1]
        undisturbed[(k, scorer)] = set(rows(root / f"clean-{k}-{scorer}", scorer))
    tables = root / "tables"
    build(tables=tables, labels=labels, k=1, scorer=HashScorer("hash@1"))
    reader = Reader(tables, expected)
    reader.start()
    done = {"kills": 0, "compared": 0}
    longest = 1.0
    while done["kills"] < kills:
        k, scorer = dice.choice(JOBS)
        action = dice.choices(("build", "refresh", "compact", "gc"), (4, 3, 1, 1))[0]
        arguments = (str(tables), labels, action, str(k), scorer, str(seconds))
        started = time.monotonic()
        if _killed(arguments, dice.uniform(0, longest)):
            done["kills"] += 1
        else:
            longest = max(longest / 2, min(2.0, time.monotonic() - started))
        check_folder(tables)
        if done["kills"] % 5 == 0 or done["kills"] == kills:
            build(tables=tables, labels=labels, k=k, scorer=HashScorer(scorer))
            assert digest(tables) == ((k, scorer), expected[(k, scorer)])
            assert set(rows(tables, scorer)) >= undisturbed[(k, scorer)]
            done["compared"] += 1
    reader.ended.set()
    reader.join()
    assert not reader.failures, reader.failures[:3]
    left = [path.name for path in (tables / SPACE.name).glob(".staging-*")]
    assert not left, left
    return done | {"looks": reader.looks}


def _killed(arguments: Sequence[str], after: float) -> bool:
    """Start a child, and kill it some seconds after its start; false where it was done before."""
    process = subprocess.Popen(
        [sys.executable, __file__, "--child", *arguments], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "ready\n"
        try:
            assert process.wait(after) == 0
            return False
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(run_faults(Path(folder), options.kills, options.seed))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        path, space, what, size, model, delay = sys.argv[2:]
        child(Path(path), space, what, int(size), model, float(delay))
    else:
        main()
