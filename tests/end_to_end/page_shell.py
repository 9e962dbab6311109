"""A shell as a reader of the pages has it: in a checkout, after `make demo`."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import select
import shutil
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from end_to_end.preloaded import CLIENT

ROOT = Path(__file__).parents[2]
DEMO = "make demo"
# What a fresh checkout does not have, or has for itself.
_OWN = {".git", ".venv", "tables", "build", "dist"}
_ENDED = "--- page: the command ended with"
_LIMIT_SECONDS = 600.0
_COLUMNS = 80
# Of an environment that is active, of this terminal, and of a `make` that runs the tests.
_NOT_A_NEW_USERS = {"VIRTUAL_ENV", "COLUMNS", "MAKEFLAGS", "MAKELEVEL", "MFLAGS"}


class Ran(NamedTuple):
    """What a command printed, as it came; of that, what was on stderr; and its exit code."""

    printed: str
    stderr: str
    code: int


class Shell:
    """One bash at a terminal of 80 columns, in one folder: variables and `cd` last.

    stderr is no terminal, so that no progress is drawn, which no two runs share.
    """

    def __init__(self, folder: Path, environment: dict[str, str], demo: Ran | None = None) -> None:
        self.folder, self.demo = folder, demo
        self._stdout, terminal = pty.openpty()
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 50, _COLUMNS, 0, 0))
        self._stderr, said = os.pipe()
        self._bash = subprocess.Popen(
            ["bash", "--noprofile", "--norc"], cwd=folder, env=environment, bufsize=0,
            stdin=subprocess.PIPE, stdout=terminal, stderr=said,
        )  # fmt: skip
        os.close(terminal)
        os.close(said)

    def run(self, command: str) -> Ran:
        """Run a command to its end."""
        if command == DEMO and self.demo is not None:
            return self.demo  # it was run in the folder that this one is a copy of
        assert self._bash.stdin is not None
        ended = f"printf -- '{_ENDED} %s\\n' $code"
        script = f"{{ {command}\n}} </dev/null; code=$?; {ended}; {ended} >&2\n"
        watch = threading.Timer(_LIMIT_SECONDS, self._bash.kill)
        watch.start()
        try:
            self._bash.stdin.write(script.encode())
            return self._read()
        finally:
            watch.cancel()

    def _read(self) -> Ran:
        """Read both files to where the shell says that the command has ended."""
        end = re.compile(rb"%s (\d+)\r?\n$" % _ENDED.encode())
        said = {self._stderr: b"", self._stdout: b""}
        printed, code = b"", 0
        while waiting := [file for file, text in said.items() if not end.search(text)]:
            ready = select.select(waiting, [], [])[0]
            for file in sorted(ready, key=[self._stderr, self._stdout].index):
                try:
                    chunk = os.read(file, 65_536)
                except OSError:  # EIO: nobody has the terminal open
                    chunk = b""
                if not chunk:
                    raise RuntimeError(f"the shell ended, or a command took too long: {said}")
                said[file] += chunk
                printed += chunk
                if found := end.search(said[file]):
                    code = int(found[1])
        plain = re.compile(rf"{_ENDED} \d+\n")
        texts = (text.decode().replace("\r\n", "\n") for text in (printed, said[self._stderr]))
        whole, stderr = (plain.sub("", text) for text in texts)
        return Ran(whole, stderr, code)

    def close(self) -> None:
        self._bash.kill()
        self._bash.wait()
        os.close(self._stdout)
        os.close(self._stderr)


class Pages:
    """Makes shells; `make demo` runs once, and every page goes on in a copy of what it left.

    A folder that was used before has that already, and what it printed.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._after_demo = folder / "after-demo"
        record = folder / "demo.json"
        if not record.exists():
            shutil.rmtree(self._after_demo, ignore_errors=True)
            record.write_text(json.dumps(self._run_demo()))
        self.demo = Ran(*json.loads(record.read_text()))

    def _run_demo(self) -> Ran:
        _checkout(self._after_demo, self._client())
        shell = Shell(self._after_demo, _environment())
        ran = shell.run(DEMO)
        shell.close()
        if ran.code:
            raise RuntimeError(f"`{DEMO}` exited {ran.code}: {ran.printed}")
        return ran

    @contextmanager
    def shell(self, name: str, activated: bool) -> Iterator[Shell]:
        """A shell in a fresh checkout after `make demo`; README.md itself begins inactivated."""
        folder = self.folder / name
        shutil.copytree(self._after_demo, folder, symlinks=True)
        shell = Shell(folder, _environment(), self.demo)
        try:
            if activated:
                shell.run("source .venv/bin/activate")
            yield shell
        finally:
            shell.close()
            shutil.rmtree(folder)

    def _client(self) -> str:
        return CLIENT.format(python=sys.executable, path=str(self.folder / "server"))


@contextmanager
def pages(folder: Path) -> Iterator[Pages]:
    """What a test of pages needs: the server of `roomtables` commands, and the demo's tables."""
    (folder / "server").unlink(missing_ok=True)
    command = [sys.executable, "-m", "end_to_end.preloaded", str(folder / "server")]
    path = os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    server = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
    )
    try:
        assert server.stdout is not None
        if server.stdout.readline() != "ready\n":
            raise RuntimeError("the server of `roomtables` commands does not start")
        yield Pages(folder)
    finally:
        server.kill()
        server.communicate()


def _checkout(folder: Path, client: str) -> None:
    """A checkout, by links, with an environment in which nothing is left to install."""
    folder.mkdir()
    for entry in ROOT.iterdir():
        if entry.name not in _OWN:
            (folder / entry.name).symlink_to(entry)
    (folder / "tables").mkdir()
    (folder / "tables" / "README.md").symlink_to(ROOT / "tables" / "README.md")
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    _program(programs / "python", f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    _program(programs / "roomtables", client)
    (programs / "activate").write_text('PATH="$PWD/.venv/bin:$PATH"\n')
    for extra in ("lm,report", "dev"):
        (folder / ".venv" / f".installed-{extra}").touch()


def _program(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


def _environment() -> dict[str, str]:
    """A new user's: no environment is active, and `roomtables` is not to be found."""
    found = {key: value for key, value in os.environ.items() if key not in _NOT_A_NEW_USERS}
    folders = [
        folder
        for folder in found["PATH"].split(os.pathsep)
        if not (Path(folder) / "roomtables").exists()
    ]
    return {**found, "PATH": os.pathsep.join(folders)}
