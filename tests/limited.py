"""Commands under real limits: a file system with little room, another user, little address space.

A command runs in a child of its own. Where it is to start in a second rather than in five, the
child is forked from a process that has imported what all commands need.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import resource
import subprocess
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from support import HashScorer

NOBODY = 65534
_PRELOADED = (
    "inflect", "duckdb", "pyarrow.parquet", "tabulate", "roomtables.cli", "roomtables.offline.plan",
    "roomtables.offline.builder", "roomtables.offline.diff", "roomtables.offline.upkeep",
    "roomtables.storage.export", "roomtables.report.page", "roomtables.lm",
)  # fmt: skip
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (minus a signal's number), stdout and stderr."""

    code: int
    said: str
    complained: str

    def check(self) -> str:
        """Check that it worked, or said in one line what to correct; the last line that it said."""
        about = f"exit code {self.code}: {self.complained or self.said}"
        assert self.code in (0, 1), about
        assert "Traceback" not in self.complained, about
        lines = [line for line in self.complained.splitlines() if not line.startswith("warning: ")]
        if self.code:
            (line,) = lines
            assert line.startswith("error: "), about
            return line
        return (self.said.splitlines() or [""])[-1]


def run_warm(
    args: Sequence[object], where: Path, user: int | None = None, **environment: str
) -> Ended:
    """Run a command in a forked child, with a scorer that needs no model.

    The child may do what modes allow it, even where the tests run as root, whom none binds; with
    ``user`` it is another user. ``where`` is a folder for what it prints.
    """
    where.mkdir(exist_ok=True)
    where.chmod(0o777)
    server = _server()
    asked = ([str(arg) for arg in args], str(where), user, environment)
    server.stdin.write(json.dumps(asked) + "\n")
    server.stdin.flush()
    code = int(server.stdout.readline())
    said, complained = ((where / name).read_text() for name in ("out", "err"))
    return Ended(code, said, complained)


@cache
def _server() -> subprocess.Popen[str]:
    """A process that has imported what commands need, and forks a child for each line it reads."""
    return subprocess.Popen(
        [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip


def _serve() -> None:
    for name in _PRELOADED:
        importlib.import_module(name)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            args, where, user, environment = json.loads(line)
            _child(args, Path(where), user, environment)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(code, flush=True)


def _child(args: list[str], where: Path, user: int | None, environment: dict[str, str]) -> None:
    os.environ.update(environment)
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(where / name, os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o666), number)
    if user is not None:
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
    _be_bound_by_modes()
    import roomtables.lm
    from roomtables.cli import main

    roomtables.lm.identify = lambda *_, **__: "hash@1"  # type: ignore[assignment]
    roomtables.lm.load_scorer = lambda *_, **__: HashScorer()  # type: ignore[assignment,return-value]
    code = 1
    try:
        main(args, prog_name="roomtables")
    except SystemExit as ended:
        code = int(ended.code or 0)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _be_bound_by_modes() -> None:
    """Give up root's right to read and write whatever a file's mode says (see capset(2))."""
    libc = ctypes.CDLL(None)
    header, sets = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    libc.capget(header, sets)
    for number in range(3):  # effective, permitted, inheritable
        sets[number] &= ~0b110  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
    assert libc.capset(header, sets) == 0


def run_cold(args: Sequence[object], address_space: int | None = None, **environment: str) -> Ended:
    """Run a command in a process of its own, with so many megabytes of address space at most."""

    def limit() -> None:
        if address_space is not None:
            most = address_space * MEGABYTE
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    found = subprocess.run(
        [sys.executable, "-m", "roomtables", *map(str, args)],
        capture_output=True, text=True, preexec_fn=limit, env=os.environ | environment,
    )  # fmt: skip
    return Ended(found.returncode, found.stdout, found.stderr)


def may_mount(folder: Path) -> bool:
    """Whether this process may mount a file system."""
    try:
        with tmpfs(folder, 1 << 16):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


@contextmanager
def tmpfs(folder: Path, size: int) -> Iterator[Path]:
    """A file system of so many bytes in a folder; unmounted at the end, whatever happens."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size},mode=777", "none", str(folder)]
    subprocess.run(mount, check=True, capture_output=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)


def leave_room(folder: Path, room: int) -> None:
    """Make a mounted file system so small that so many bytes are left of it."""
    facts = os.statvfs(folder)
    size = (facts.f_blocks - facts.f_bfree) * facts.f_frsize + room
    remount = ["mount", "-o", f"remount,size={size}", str(folder)]
    subprocess.run(remount, check=True, capture_output=True)


if __name__ == "__main__":
    _serve()
