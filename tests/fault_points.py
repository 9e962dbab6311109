"""Ends or interrupts a command at each change that it makes to the disk, and checks what is left.

A change is a system call: ``rename``, ``unlink``, ``rmdir``, ``mkdir``, ``link``, ``symlink``,
``fsync``, ``fdatasync``, ``open`` for writing, ``write``, ``pwrite``, ``truncate``, ``fallocate``.
``fault_points.c`` counts those under a folder, whichever library makes them, and sends the process
a signal at the n-th. Each run is a fork of a process that has imported everything and started no
thread, so that a point costs a fraction of a second. Linux with a C compiler.

By hand: ``python tests/fault_points.py compact --signal SIGTERM``.
"""

from __future__ import annotations

import argparse
import ctypes
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from multiprocessing.connection import wait
from pathlib import Path
from signal import Signals
from threading import Lock
from typing import Any

from fault_commands import COMMANDS, Command, Site, litter, same

SOURCE = Path(__file__).with_name("fault_points.c")
_IMPORTED_ONCE = ["fault_imports"]
WORKERS = 2
INTERRUPTED = 130


class UnavailableError(Exception):
    """This machine cannot inject faults; the message says why."""


def compiled(folder: Path) -> Path:
    """The shared library that counts calls.

    Raises
    ------
    UnavailableError
        There is no C compiler, or the system is not one that the library knows.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or sys.platform != "linux":
        raise UnavailableError("faults are injected on Linux, with a C compiler (cc, gcc or clang)")
    library = folder / "fault_points.so"
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE)]
    made = subprocess.run(command, capture_output=True, text=True)
    if made.returncode:
        raise UnavailableError(f"fault_points.c cannot be compiled: {made.stderr[-300:]}")
    return library


@dataclass(frozen=True)
class Point:
    """A moment in a command: its n-th change (0: none), and the signal that comes then."""

    call: int
    signal: Signals

    def __str__(self) -> str:
        return f"{self.signal.name} at call {self.call}"


@dataclass
class Swept:
    """What a sweep of one command found.

    ``points`` of its ``calls`` were tried, once for each signal, and at ``hit`` of them the signal
    came. Their files were in so many ``states``, each of which was checked once; ``failures`` says
    what was wrong, and where.
    """

    command: str
    calls: int
    points: int
    hit: int = 0
    states: set[str] = field(default_factory=set)
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        hit = f"{self.hit} of {self.points} points hit"
        states = f"{len(self.states)} states"
        return f"{self.command}: {self.calls} calls, {hit}, {states}, {len(self.failures)} failures"


def worth_trying(calls: Sequence[str]) -> list[int]:
    """Numbers of the calls to disturb: all, but of more than eight in a row that write or flush one
    file the first four, the last four, and every fourth between (DuckDB's log of the workspace)."""
    runs = [
        list(run) for _, run in groupby(range(len(calls)), lambda at: _written(calls[at]) or at)
    ]
    kept = ([*run[:4], *run[4:-4:4], *run[-4:]] if len(run) > 8 else run for run in runs)
    return [at + 1 for run in kept for at in run]


def first_of(calls: Sequence[str], end: str) -> int:
    """The number of the first call whose path ends so."""
    return next(number for number, call in enumerate(calls, start=1) if call.endswith(end))


def _written(call: str) -> str:
    """The file that a call writes or flushes; empty for other calls."""
    name, path = call.split(" ", 1)
    return path if "write" in name or "sync" in name else ""


def spread(numbers: Sequence[int], most: int | None, phase: float) -> list[int]:
    """At most so many of some numbers, evenly; ``phase`` from 0 to 1 shifts which."""
    if most is None or most >= len(numbers):
        return list(numbers)
    return [numbers[int((n + phase) * len(numbers) / most)] for n in range(most)]


@dataclass(frozen=True)
class Bench:
    """A folder in which commands are run, and the library that counts their calls."""

    folder: Path
    library: Path
    _undisturbed: dict[str, tuple[dict[str, Any], list[str]]] = field(default_factory=dict)

    @classmethod
    @contextmanager
    def open(cls) -> Iterator[Bench]:
        """A bench in memory where there is such a folder: a disk would wait for each fsync.

        Raises
        ------
        UnavailableError
            As :func:`compiled`, or the system refuses the filter.
        """
        memory = Path("/dev/shm")
        where = memory if memory.is_dir() and os.access(memory, os.W_OK) else None
        with tempfile.TemporaryDirectory(prefix="fault-points-", dir=where) as folder:
            bench = cls(Path(folder).resolve(), compiled(Path(folder)))
            refused = bench.call(_arm, bench.library, bench.folder, Point(0, signal.SIGKILL), -1)
            if refused:
                raise UnavailableError(f"this system traps no calls: {os.strerror(refused)}")
            yield bench

    def call(self, target: Callable[..., Any], *args: Any) -> Any:
        """What a function returns in a forked child; whatever it raises is raised here as text."""
        path = Path(tempfile.mkdtemp(dir=self.folder)) / "answer"
        code = _exit_code(_answer, (path, target, args))
        assert code == 0, f"{target.__name__} ended with {code}"
        raised, answer = pickle.loads(path.read_bytes())
        shutil.rmtree(path.parent)
        if raised:
            raise AssertionError(answer)
        return answer

    def start(self, command: Command) -> Path:
        """The files that a command starts from."""
        site = Site(self.folder / "starts" / command.prepare.__name__)
        if not site.root.is_dir():
            site.make()
            self.call(command.prepare, site)
        return site.root

    def undisturbed(self, command: Command) -> tuple[dict[str, Any], list[str]]:
        """What is there after a run that nothing disturbs, and the calls that it makes."""
        if command.name not in self._undisturbed:
            log = self.folder / f"{command.name}.calls"
            with self._copied(command, "undisturbed") as site:
                code, said = self.run(site, command, Point(0, signal.SIGKILL), log)
                assert (code, said) == (0, ""), f"{command.name} undisturbed: {code} {said}"
                found = self.call(Site.contents, site), log.read_text().splitlines()
            self._undisturbed[command.name] = found
        return self._undisturbed[command.name]

    @contextmanager
    def _copied(self, command: Command, name: str) -> Iterator[Site]:
        root = self.folder / command.name / name.replace(" ", "-")
        shutil.copytree(self.start(command), root, symlinks=True)
        try:
            if command.placed is not None:
                self.call(command.placed, Site(root))
            yield Site(root)
        finally:
            shutil.rmtree(root, ignore_errors=True)

    def run(
        self, site: Site, command: Command, point: Point, log: Path | None = None
    ) -> tuple[int, str]:
        """Run a command to a point; its exit code, and what it said on stderr."""
        said = site.root.with_suffix(".said")
        code = _exit_code(_run, (self.library, site, command.args(site), point, said, log))
        try:
            return code, said.read_text()
        finally:
            said.unlink()

    def sweep(self, command: Command, signals: Sequence[Signals], most: int | None = None) -> Swept:
        """Disturb a command at every call, or at ``most`` for each signal, spread evenly."""
        expected, calls = self.undisturbed(command)
        chosen = [call for call in worth_trying(calls) if call >= first_of(calls, command.behind)]
        points = [
            Point(number, sent)
            for place, sent in enumerate(signals)
            for number in spread(chosen, most, (place + 1) / (len(signals) + 1))
        ]
        swept = Swept(command.name, len(calls), len(points))
        with ThreadPoolExecutor(WORKERS) as pool:
            tried = pool.map(lambda p: self._try(command, p, expected, swept.states), points)
            for point, hit, wrong in tried:
                swept.hit += hit
                if wrong:
                    called = calls[point.call - 1].replace(str(self.folder), "")
                    swept.failures.append(f"{command.name}, {point} ({called}): {wrong}")
        return swept

    def _try(
        self, command: Command, point: Point, expected: dict[str, Any], states: set[str]
    ) -> tuple[Point, bool, str]:
        """Disturb a run at a point: whether the signal came, and what was wrong afterwards.

        What follows depends on the files alone: a state of ``states`` was checked before.
        """
        with self._copied(command, str(point)) as site:
            code, said = self.run(site, command, point)
            killed = point.signal == signal.SIGKILL
            hit = code != 0
            wrong = ""
            said = said[-600:]
            if hit and code != (-signal.SIGKILL if killed else INTERRUPTED):
                wrong = f"exit code {code}: {said}"
            elif hit and not killed and said.count("\n") != 1:
                wrong = f"said {said!r}"
            elif not hit and not killed:
                wrong = "the signal was lost"
            if (state := site.state()) not in states:
                states.add(state)
                try:
                    self.call(_afterwards, site, command, expected)
                except AssertionError as error:
                    wrong += f" {str(error)[-600:]}"
            return point, hit, wrong


# A start asks how all children fare, and so does a join: of two at once one learns nothing.
_STARTING = Lock()


def _exit_code(target: Callable[..., Any], args: Sequence[Any]) -> int:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED_ONCE)
    process = context.Process(target=target, args=args)
    with _STARTING, _tests_on_the_path():
        process.start()
    wait([process.sentinel])
    with _STARTING:
        process.join()
    assert process.exitcode is not None
    return process.exitcode


@contextmanager
def _tests_on_the_path() -> Iterator[None]:
    """The process that the runs are forked from goes by PYTHONPATH; what it cannot import, each of
    them imports."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(SOURCE.parent), *([before] if before else [])])
    try:
        yield
    finally:
        del os.environ["PYTHONPATH"]
        if before is not None:
            os.environ["PYTHONPATH"] = before


def _answer(path: Path, target: Callable[..., Any], args: Sequence[Any]) -> None:
    """In a child: call, and leave the answer in a file."""
    _redirect(Path(os.devnull), 1)
    try:
        answer = (False, target(*args))
    except BaseException:
        answer = (True, traceback.format_exc())
    path.write_bytes(pickle.dumps(answer))


def _arm(library: Path, root: Path, point: Point, log: int) -> int:
    arm = ctypes.CDLL(str(library)).arm
    return int(arm(os.fsencode(root), ctypes.c_long(point.call), int(point.signal), log))


def _run(
    library: Path, site: Site, args: Sequence[str], point: Point, said: Path, log: Path | None
) -> None:
    """In a child: one command, as from a shell, with the signals of a foreground job."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _redirect(said, 2)
    _redirect(Path(os.devnull), 1)
    calls = os.open(log, os.O_CREAT | os.O_WRONLY | os.O_TRUNC) if log else -1
    with site.entered() as main:
        refused = _arm(library, site.root, point, calls)
        assert not refused, os.strerror(refused)
        main(args)


def _redirect(path: Path, descriptor: int) -> None:
    handle = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(handle, descriptor)
    os.close(handle)


def _afterwards(site: Site, command: Command, expected: dict[str, Any]) -> None:
    """In a child: a reader answers; the command runs again and makes the same; `gc` leaves none."""
    site.read(command.published)
    if not (command.done and command.done(site)):
        site.run(command.args(site))
    site.run(["gc", "--tables", str(site.tables)])
    left = litter(site)
    assert not left, f"left after gc: {left}"
    site.read(True)
    # A build that finds done what the disturbed one did notes that, too.
    found = site.contents() | ({} if expected["checked"] else {"checked": False})
    differing = same(expected, found)
    assert not differing, f"after the next {command.name} and gc: {differing}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="*", help=", ".join(COMMANDS))
    parser.add_argument("--signal", action="append", choices=["SIGKILL", "SIGTERM", "SIGINT"])
    parser.add_argument("--most", type=int, help="calls to try, spread evenly")
    parser.add_argument("--list", action="store_true", help="the calls, undisturbed")
    options = parser.parse_args()
    signals = [Signals[name] for name in options.signal or ["SIGKILL"]]
    with Bench.open() as bench:
        for name in options.commands or COMMANDS:
            if options.list:
                print(*bench.undisturbed(COMMANDS[name])[1], sep="\n")
                continue
            swept = bench.sweep(COMMANDS[name], signals, options.most)
            print(swept, *swept.failures[:5], sep="\n", flush=True)


if __name__ == "__main__":
    main()
