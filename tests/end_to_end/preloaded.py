"""`roomtables` as a server that has imported everything: it forks a process for every command.

Python needs seconds to import torch and half of one for the command line; pages run dozens of
commands. A client hands its arguments, folder, environment and open files over a Unix socket, and
exits as the command does. Whatever a command does, it does in a process of its own.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import socket
import sys
import traceback

# Runs with `python -SE`, which starts in a hundredth of a second.
CLIENT = """#!{python} -SE
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({path!r})
    asked = dict(words=sys.argv[1:], folder=os.getcwd(), environment=dict(os.environ))
    socket.send_fds(server, [b"\\0"], [0, 1, 2])
    with server.makefile("rw") as lines:
        print(json.dumps(asked), file=lines, flush=True)
        sys.exit(int(lines.readline() or 70))
"""

IMPORTED = ("roomtables.cli", "roomtables.lm.scorer", "duckdb", "pyarrow.parquet",
            "matplotlib.figure", "onnxruntime")  # fmt: skip


def serve(path: str) -> None:
    """Answer clients until killed."""
    for module in IMPORTED:
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for what is forked
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path)
        server.listen()
        print("ready", flush=True)
        while True:
            client, _ = server.accept()
            if os.fork() == 0:
                server.close()
                os._exit(_answer(client))
            client.close()


def _answer(client: socket.socket) -> int:
    """Run one command and tell the client its exit code."""
    from roomtables.cli import main

    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    _, files, _, _ = socket.recv_fds(client, 1, 3)
    for number, file in enumerate(files):
        os.dup2(file, number)
    with client, client.makefile("rw") as lines:
        asked = json.loads(lines.readline())
        os.chdir(asked["folder"])
        os.environ.clear()
        os.environ.update(asked["environment"])
        sys.argv = ["roomtables", *asked["words"]]
        code: object = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        print(int(code or 0) if not isinstance(code, str) else 1, file=lines, flush=True)
    return 0


if __name__ == "__main__":
    serve(sys.argv[1])
