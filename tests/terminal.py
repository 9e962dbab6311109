"""Commands at a terminal of a given width, as a person sees them."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import NamedTuple

_PROGRAM = "from roomtables.cli import main; main(prog_name='roomtables')"


class Shown(NamedTuple):
    """What a command wrote to the terminal, what to stderr where that is none, and its code."""

    terminal: str
    stderr: str
    code: int


def at_terminal(
    columns: int, *arguments: object, cwd: Path | None = None, all_of_it: bool = False
) -> Shown:
    """Run ``roomtables`` with its output on a terminal; ``all_of_it``: stderr, too."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *map(str, arguments)],
        stdin=subprocess.DEVNULL, stdout=theirs, cwd=cwd, env=environment,
        stderr=theirs if all_of_it else subprocess.PIPE,
    )  # fmt: skip
    os.close(theirs)
    shown = _read(ours)
    os.close(ours)
    stderr = b"" if all_of_it else process.communicate()[1]
    return Shown(shown.replace("\r\n", "\n"), stderr.decode(), process.wait())


def _read(terminal: int) -> str:
    """All that comes until the last process leaves the terminal."""
    chunks = []
    while True:
        try:
            chunk = os.read(terminal, 65_536)
        except OSError:  # EIO: nobody has it open
            chunk = b""
        if not chunk:
            return b"".join(chunks).decode()
        chunks.append(chunk)
