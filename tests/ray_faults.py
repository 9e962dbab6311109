"""Kill an actor of a Ray build, then the driver of another: `python tests/ray_faults.py`.

Both times the rows must be those of an undisturbed local build, each sentence once.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from faults import SPACE, SlowScorer, check_folder, rows
from roomtables import build
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, write_space

SECONDS = 0.02  # per sentence


def child(tables: str, labels: str) -> None:
    """Build on two actors."""
    scorer = SlowScorer("hash@1", SECONDS)
    report = build(tables=tables, labels=labels, scorer=scorer, engine="ray", workers=2)
    print(report.sentences_scored, report.sentences_cached)


def start(tables: Path, labels: str) -> subprocess.Popen[str]:
    command = [sys.executable, __file__, "--child", str(tables), labels]
    paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    )


def actors(driver: int) -> list[psutil.Process]:
    """The actors of a driver's own cluster."""
    found = psutil.Process(driver).children(recursive=True)
    return [p for p in found if "ShardWriter" in " ".join(p.cmdline())]


def wait_for_parts(tables: Path, count: int) -> None:
    while len(list(tables.glob("scores/*/**/part-*"))) < count:
        time.sleep(0.2)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        labels = str(write_space(root / "labels", SPACE))
        build(tables=root / "local", labels=labels, scorer=HashScorer())
        expected = rows(root / "local", "hash@1")

        process = start(root / "actor", labels)
        wait_for_parts(root / "actor", 2)
        while not (found := actors(process.pid)):
            time.sleep(0.2)
        found[0].kill()
        print("killed actor", found[0].pid, "of", len(found))
        said, _ = process.communicate(timeout=500)
        assert process.returncode == 0
        print("actor killed: scored, cached =", said.strip())
        check_folder(root / "actor")
        assert rows(root / "actor", "hash@1") == expected

        process = start(root / "driver", labels)
        wait_for_parts(root / "driver", 6)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert SpaceFolder(root / "driver", SPACE.name).published() is None
        process = start(root / "driver", labels)
        said, _ = process.communicate(timeout=500)
        assert process.returncode == 0
        print("driver killed: scored, cached =", said.strip())
        check_folder(root / "driver")
        assert rows(root / "driver", "hash@1") == expected


if __name__ == "__main__":
    child(*sys.argv[2:]) if sys.argv[1:2] == ["--child"] else main()
