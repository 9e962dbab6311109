"""Builds that are killed at random moments, and what must hold of the folder they leave.

A child process builds, compacts or collects garbage; the parent kills it with SIGKILL after a
random time, checks the tables folder, and starts the next child in the same folder. Meanwhile a
thread opens the published version again and again. Run as a script for a longer look:
``python tests/faults.py --kills 50``.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import random
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
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
# What a child builds: the largest combination (k), and the scorer's identity.
Job = tuple[int, str]
JOBS: tuple[Job, ...] = ((1, "hash@1"), (2, "hash@1"), (3, "hash@1"), (2, "hash@2"))
ACTIONS = {"build": 4, "refresh": 3, "compact": 1, "gc": 1}  # with how often each is drawn
# What takes a child seconds to import, so that a kill met it importing.
_IMPORTED_ONCE = ["inflect", "pandas", "roomtables.offline.builder", "roomtables.offline.upkeep"]
_UPKEEP_SECONDS = 0.3  # that compacting or collecting garbage takes, about
_BETWEEN_LOOKS = 0.02  # seconds: the reader must not take the time of the processes it looks at


class SlowScorer(HashScorer):
    """A :class:`HashScorer` that takes half a millisecond per sentence, as a model would."""

    def score_stream(self, sentences):
        for score in super().score_stream(sentences):
            time.sleep(0.0005)
            yield score


def child(tables: Path, labels: str, action: str, job: Job) -> None:
    """What a child does: one action, and nothing else."""
    scoring.PART_SENTENCES = 50  # so that a build writes several parts
    if action == "compact":
        upkeep.compact(tables)
    elif action == "gc":
        upkeep.collect_garbage(tables)
    else:
        k, scorer = job
        refresh = action == "refresh"
        build(tables=tables, labels=labels, k=k, scorer=SlowScorer(scorer), full_refresh=refresh)


def digest(tables: Path) -> tuple[Job, str]:
    """Which job made the published version, and a hash of what a lookup of it holds."""
    version = SpaceFolder(tables, SPACE.name).current()
    lookup = Lookup.open(version.path / "lookup", version.manifest)
    arrays = lookup.sources["proxy"]
    content = hashlib.sha256()
    # Entropies are sums, and the order of their terms is DuckDB's: equal to a tolerance only.
    for array in (arrays.keys, arrays.scores, arrays.entropy.round(9), arrays.ranks):
        content.update(array.tobytes())
    return (version.manifest.settings.k, version.manifest.scorer_id), content.hexdigest()


@dataclass
class Reader(threading.Thread):
    """Opens the published version again and again; whatever it sees must be one of ``expected``."""

    tables: Path
    expected: dict[Job, str]
    looks: int = 0
    failures: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(daemon=True)
        self.ended = threading.Event()

    def __hash__(self) -> int:
        return id(self)

    def run(self) -> None:
        while not self.ended.wait(_BETWEEN_LOOKS):
            try:
                job, content = digest(self.tables)
            except Exception as error:
                self.failures.append(repr(error))
                continue
            if self.expected[job] != content:
                self.failures.append(f"{job} is mixed")
            self.looks += 1


def rows(tables: Path, scorer: str) -> list[tuple[Any, ...]]:
    """All sentence scores of a scorer, sorted."""
    select = SentenceCache(tables, scorer).select()
    return duckdb.connect().execute(f"from ({select}) order by all").fetchall()


def check_folder(tables: Path) -> None:
    """Check what must hold at any moment: whole parts, and no sentence twice."""
    for folder in sorted((tables / "scores").glob("*")):
        SentenceCache(tables, folder.name).verify()
        sentences = [row[1] for row in rows(tables, folder.name)]
        assert len(sentences) == len(set(sentences)), f"{folder} holds a sentence twice"


@dataclass
class Trial:
    """A tables folder in which children are killed, and what undisturbed builds make.

    ``expected`` are the digests, ``scores`` the sentence scores, ``seconds`` the times they take.
    """

    tables: Path
    labels: str
    expected: dict[Job, str] = field(default_factory=dict)
    scores: dict[Job, set[tuple[Any, ...]]] = field(default_factory=dict)
    seconds: dict[Job, float] = field(default_factory=dict)

    @classmethod
    def start(cls, root: Path) -> Trial:
        """Build every job undisturbed, each in a folder of its own, and the first in ``tables``."""
        trial = cls(root / "tables", str(write_space(root / "labels", SPACE)))
        _exit_code(int, (), None)  # the first child waits for what is imported once
        for job in JOBS:
            clean = root / f"clean-{job[0]}-{job[1]}"
            started = time.monotonic()
            assert not trial.killed("build", job, clean)
            trial.seconds[job] = time.monotonic() - started
            trial.expected[job] = digest(clean)[1]
            trial.scores[job] = set(rows(clean, job[1]))
        assert not trial.killed("build", JOBS[0], trial.tables)
        return trial

    def killed(self, action: str, job: Job, tables: Path, after: float | None = None) -> bool:
        """Start a child and kill it some seconds later; false where it had ended before."""
        code = _exit_code(child, (tables, self.labels, action, job), after)
        assert code in (0, -signal.SIGKILL), f"{action} of {job} exited {code}"
        return code != 0

    def compare(self, job: Job) -> None:
        """Let a job end, and check that it makes what it makes undisturbed."""
        assert not self.killed("build", job, self.tables)
        assert digest(self.tables) == (job, self.expected[job])
        assert set(rows(self.tables, job[1])) >= self.scores[job]
        assert not staged(self.tables)


def _exit_code(target: Callable[..., Any], args: Sequence[Any], after: float | None) -> int | None:
    """Run something in a child that is killed some seconds later, unless it has ended."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED_ONCE)
    process = context.Process(target=target, args=args)
    process.start()
    process.join(after)
    process.kill()
    process.join()
    return process.exitcode


def staged(tables: Path) -> list[Path]:
    """What a build that has not ended has written of a version."""
    return list((tables / SPACE.name).glob(".staging-*"))


def run_faults(root: Path, kills: int, seed: int) -> dict[str, int]:
    """Kill ``kills`` children; compare with undisturbed builds after every fifth and the last.

    Returns how many children were killed, how many of them left a version half written, how
    many builds were compared, and how often was read.
    """
    dice = random.Random(seed)
    trial = Trial.start(root)
    reader = Reader(trial.tables, trial.expected)
    reader.start()
    done = {"kills": 0, "half_written": 0, "compared": 0}
    while done["kills"] < kills:
        job = dice.choice(JOBS)
        action = dice.choices(list(ACTIONS), list(ACTIONS.values()))[0]
        longest = trial.seconds[job] if action in ("build", "refresh") else _UPKEEP_SECONDS
        if not trial.killed(action, job, trial.tables, dice.uniform(0, longest)):
            continue
        done["kills"] += 1
        done["half_written"] += bool(staged(trial.tables))
        check_folder(trial.tables)
        if done["kills"] % 5 == 0 or done["kills"] == kills:
            trial.compare(job)
            done["compared"] += 1
    reader.ended.set()
    reader.join()
    assert not reader.failures, reader.failures[:3]
    return done | {"looks": reader.looks}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(run_faults(Path(folder), options.kills, options.seed))


if __name__ == "__main__":
    main()
