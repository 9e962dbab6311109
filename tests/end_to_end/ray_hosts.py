"""The cluster build of docs/scale.md, on three hosts of one machine; one dies in the middle.

    python tests/end_to_end/ray_hosts.py             # needs root: hosts are Linux namespaces

The head schedules; two workers score, one of them until half of the sentences are done. What the
build then published is compared with a local build: the same rows, none missing and none twice.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from network_hosts import Host, hosts, why_not
from roomtables.storage.versions import SpaceFolder

PORT = 6379
BIN = Path(sys.executable).parent
# As the page says, but for what this machine lacks: a core each, however many hosts there are.
HEAD = ("ray", "start", "--head", f"--port={PORT}", "--num-cpus=0")
TOKEN = {"RAY_AUTH_MODE": "token"}
WORKER = ("ray", "start", "--num-cpus=1")


@dataclass(frozen=True)
class Outcome:
    """What the two builds made of the same sentences."""

    said: str  # the last line of the cluster's build
    again: str  # of the same build, once more
    seconds: float
    lost_at: float  # seconds into the build when the worker was killed
    scored_by_then: int  # sentences
    rows: int  # of query_scores, source proxy
    same_combinations: bool
    furthest: float  # nats between two scores of one sentence
    best_rooms_equal: int
    sentences: int  # in the cluster's score parts
    sentences_twice: int


def run(folder: Path, labels: str = "mpcat40", k: int = 3) -> Outcome:
    """Build locally and on the cluster, in ``folder``; both as processes of their own."""
    options = ("--labels", labels, "-k", str(k), "--combinations", "all")
    local, shared = folder / "local", folder / "shared"
    _say("local build")
    program = str(BIN / "roomtables")
    subprocess.run([program, "build", *options, "--tables", str(local)], check=True)
    with hosts(("head", "worker1", "worker2"), folder / "homes") as (head, *workers):
        _say("cluster: " + ", ".join(f"{host.name} {host.address}" for host in (head, *workers)))
        _start(head, workers)
        words = (program, "build", *options, "--tables", str(shared), "--engine", "ray")
        environment = {"RAY_ADDRESS": f"{head.address}:{PORT}", **TOKEN}
        started = time.monotonic()
        build = subprocess.Popen(
            head.command(words), env=head.environment(**environment), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        done = _half_done(shared, len(_sentences(local)), build)
        lost_at = time.monotonic() - started
        _say(f"{done:,} sentences are scored after {lost_at:.0f} s: killing {workers[1].name}")
        workers[1].kill()
        said, _ = build.communicate()
        seconds = time.monotonic() - started
        if build.returncode:
            raise RuntimeError(f"the build failed: {said}")
        again = head.run(*words, **environment)
    _say(f"built in {seconds:.0f} s")
    found = _compared(local, shared, labels)
    return Outcome(said.splitlines()[-1], again.splitlines()[-1], seconds, lost_at, done, **found)


def _start(head: Host, workers: list[Host]) -> None:
    """The token, the head, the workers: the page's commands."""
    head.run(str(BIN / "ray"), "get-auth-token", "--generate")
    token = (head.home / ".ray" / "auth_token").read_bytes()
    _on(head, *HEAD, f"--node-ip-address={head.address}")
    for worker in workers:
        (worker.home / ".ray").mkdir()
        (worker.home / ".ray" / "auth_token").write_bytes(token)
        _on(worker, *WORKER, f"--address={head.address}:{PORT}",
            f"--node-ip-address={worker.address}")  # fmt: skip


def _on(host: Host, program: str, *words: str) -> None:
    host.run(str(BIN / program), *words, RAY_USAGE_STATS_ENABLED="0", **TOKEN)


def _half_done(tables: Path, sentences: int, build: subprocess.Popen[str]) -> int:
    """Wait until half of the sentences are in the cache; returns how many."""
    while build.poll() is None:
        parts = list(tables.glob("scores/*/part-*.parquet"))
        done = sum(pq.read_metadata(part).num_rows for part in parts)
        if 2 * done >= sentences:
            return done
        time.sleep(0.1)
    raise RuntimeError(f"the build ended before a worker could be killed: {build.communicate()[0]}")


def _compared(local: Path, shared: Path, labels: str) -> dict[str, object]:
    """How the rows of two tables folders differ."""
    ours, theirs = (_query_scores(tables, labels) for tables in (local, shared))
    same = [list(table) for table in (ours, theirs)]
    scores = [np.array(list(table.values())) for table in (ours, theirs)]
    sentences = _sentences(shared)
    equal = same[0] == same[1]
    return {
        "rows": len(theirs),
        "same_combinations": equal,
        "furthest": float(np.abs(scores[0] - scores[1]).max()) if equal else float("nan"),
        "best_rooms_equal": int((scores[0].argmax(1) == scores[1].argmax(1)).sum()) if equal else 0,
        "sentences": len(sentences),
        "sentences_twice": len(sentences) - len(set(sentences)),
    }


def _sentences(tables: Path) -> list[str]:
    """Every sentence in the score parts, as often as it is there."""
    parts = [pq.read_table(path) for path in tables.glob("scores/*/part-*.parquet")]
    return [text for part in parts for text in part.column("sentence").to_pylist()]


def _query_scores(tables: Path, labels: str) -> dict[tuple[str, ...], list[float]]:
    """A row of scores by combination, sorted by combination."""
    version = SpaceFolder(tables, labels).current().path
    rows = pq.read_table(version / "query_scores.parquet").to_pylist()
    apart = ("source", "key", "objects")
    found = {
        tuple(row["objects"]): [value for name, value in row.items() if name not in apart]
        for row in rows
    }
    assert len(found) == len(rows)
    return dict(sorted(found.items()))


def _say(text: str) -> None:
    print(time.strftime("%H:%M:%S"), text, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--labels", default="mpcat40")
    parser.add_argument("-k", type=int, default=3)
    options = parser.parse_args()
    if reason := why_not():
        print(f"error: {reason}", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        outcome = run(Path(folder), options.labels, options.k)
    for name, value in vars(outcome).items():
        print(f"{name:18} {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
