"""Bytes and seconds of pulls from a folder, beside a plain copy of the same files.

    python tests/benchmarks/fleet.py                # nyuclass, combinations of one or two objects
    python tests/benchmarks/fleet.py --made         # of up to three, with made-up scores

Pulls verify every byte twice, flush it, and switch; the copy (`shutil.copytree`) does none of it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import shutil
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from multiprocessing.synchronize import Barrier
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import made_tables
from table_side import Forgetful

from roomtables import RoomTables, build
from roomtables.config import load_labels
from roomtables.storage.packed import Packed
from roomtables.storage.pulling import Pulled, pull
from roomtables.storage.pushing import push
from roomtables.storage.versions import LOOKUP, SpaceFolder
from support import write_space

LABELS = "nyuclass"
ROBOTS = 20
RUNS = 5


def build_night(folder: Path, changed: int) -> None:
    """Build, with the first so many objects called otherwise than the night before."""
    space = load_labels(LABELS)
    objects = [
        replace(label, plural=f"other {label.plural}") if number < changed else label
        for number, label in enumerate(space.objects)
    ]
    labels = write_space(folder / "labels", replace(space, objects=tuple(objects)))
    build(tables=folder / "tables", labels=str(labels), scorer=Forgetful(), k=2, combinations="all")


def copied(source: Path, target: Path) -> float:
    """Seconds of a plain copy."""
    started = time.perf_counter()
    shutil.copytree(source, target)
    seconds = time.perf_counter() - started
    shutil.rmtree(target)
    return seconds


def say(what: str, done: Pulled, seconds: list[float], copy: list[float]) -> None:
    taken, plain = statistics.median(seconds), statistics.median(copy)
    print(
        f"{what:22} {done.bytes_fetched / 1e6:9.2f} MB {taken:8.3f} s   "
        f"copy of all {plain:.3f} s, ratio {taken / plain:.1f}"
    )


def one_robot(root: Path, url: str, number: int, start: Barrier, wanted: str) -> None:
    """Pull until the wanted version is here; answer after every pull."""
    tables = root / f"robot{number}"
    start.wait()
    while pull(tables, LABELS, url).version != wanted:
        pass
    answer = RoomTables.open(tables, LABELS, offline=True).classify(["bed"])
    assert answer.room


def copy_many(root: Path, source: Path) -> float:
    """Seconds in which as many processes as there are robots copy the files."""
    fork = multiprocessing.get_context("fork")
    targets = [root / f"copy{number}" for number in range(ROBOTS)]
    jobs = [fork.Process(target=shutil.copytree, args=(source, target)) for target in targets]
    started = time.perf_counter()
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
        assert job.exitcode == 0
    seconds = time.perf_counter() - started
    for target in targets:
        shutil.rmtree(target)
    return seconds


class Bench:
    """A folder that builds, a place, and robots."""

    def __init__(self, root: Path, made: bool) -> None:
        self.root, self.made = root, made
        self.tables, self.url = root / "tables", f"file://{root}/place"

    def build(self, night: int) -> None:
        """Build what a night builds: one more object changed, or made-up scores anew."""
        if self.made:
            made_tables.make(self.tables, LABELS, seed=night)
        else:
            build_night(self.root, night)

    def lookup(self) -> Path:
        return SpaceFolder(self.tables, LABELS).current().path / LOOKUP

    def push(self) -> str:
        return push(self.tables, LABELS, self.url).version

    def measure(self, what: str) -> None:
        """Pull into a few folders, one after another, and copy as often between."""
        pulls, copies = [], []
        for number in range(RUNS):
            copies.append(copied(self.lookup(), self.root / "copy"))
            started = time.perf_counter()
            done = pull(self.root / f"first{number}", LABELS, self.url)
            pulls.append(time.perf_counter() - started)
        say(what, done, pulls, copies)


def pull_many(bench: Bench) -> float:
    """Seconds until all robots have what a push sends meanwhile."""
    fork = multiprocessing.get_context("fork")
    start = fork.Barrier(ROBOTS + 1)
    wanted = Packed.of(SpaceFolder(bench.tables, LABELS).current()).pointer.name
    jobs = [
        fork.Process(target=one_robot, args=(bench.root, bench.url, number, start, wanted))
        for number in range(ROBOTS)
    ]
    for job in jobs:
        job.start()
    start.wait()
    started = time.perf_counter()
    assert bench.push() == wanted
    for job in jobs:
        job.join()
        assert job.exitcode == 0
    return time.perf_counter() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--made", action="store_true", help="large tables, with made-up scores")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fleet-") as name:
        bench = Bench(Path(name), options.made)
        bench.build(0)
        bench.push()
        files = [path for path in bench.lookup().rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        print(f"lookup: {len(files)} files, {size / 1e6:.2f} MB; seconds: medians of {RUNS}")
        bench.measure("first pull")
        bench.measure("nothing new")
        bench.build(1)
        bench.push()
        bench.measure("after a night")
        bench.build(2)
        plain = copy_many(bench.root, bench.lookup())
        taken = pull_many(bench)
        print(
            f"{ROBOTS} robots at once, while a push runs: {taken:.2f} s; "
            f"{ROBOTS} copies at once {plain:.2f} s, ratio {taken / plain:.1f}"
        )


if __name__ == "__main__":
    main()
