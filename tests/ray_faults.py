"""A scorer that kills a process of a build on Ray, and such a build as a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path

from roomtables import build
from support import HashScorer

WORKERS = 2


class KillsOnce(HashScorer):
    """Kills its own process or another, once: when it has scored ``after`` sentences.

    ``flag`` is the file that says, to every process with a copy of the scorer, that it is done.
    """

    def __init__(self, flag: Path, after: int, victim: int | None = None) -> None:
        super().__init__()
        self.flag, self.after, self.victim = flag, after, victim

    def score_stream(self, sentences):
        for score in super().score_stream(sentences):
            if len(self.asked) >= self.after and self._is_first():
                os.kill(self.victim or os.getpid(), signal.SIGKILL)
            yield score

    def _is_first(self) -> bool:
        try:
            self.flag.touch(exist_ok=False)
        except FileExistsError:
            return False
        return True


def build_on_ray(tables: Path, labels: str, flag: Path, after: int) -> int | None:
    """Build in a child that is killed when an actor has scored some sentences; its exit code."""
    arguments = (tables, labels, flag, after)
    child = multiprocessing.get_context("spawn").Process(target=_build, args=arguments)
    child.start()
    child.join()
    return child.exitcode


def _build(tables: Path, labels: str, flag: Path, after: int) -> None:
    scorer = KillsOnce(flag, after, victim=os.getpid())
    build(tables=tables, labels=labels, scorer=scorer, engine="ray", workers=WORKERS)
