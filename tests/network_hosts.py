"""Hosts on one machine: each has its own network, processes, host name, shared memory and home.

A host is a set of Linux namespaces, kept alive by its first process; all hosts hang on one switch,
a bridge in a namespace of its own. When a host's first process is killed, the kernel kills all
others of the host and removes its network card: what a power cut does. Nothing is left behind.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

_NAMESPACES = ("--net", "--mount", "--uts", "--ipc", "--pid")
# What a host needs of its own; the rest of the file system is that of the machine, shared.
_FIRST_PROCESS = """
mount --make-rprivate / && mount -t proc proc /proc && mount -t tmpfs tmpfs /dev/shm
mkdir -p /tmp/ray && mount -t tmpfs tmpfs /tmp/ray
hostname {name} && ip link set lo up && touch {home}/.up && exec sleep infinity
"""


def why_not() -> str | None:
    """Why hosts cannot be made here; None where they can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    for program in ("unshare", "nsenter", "ip"):
        if shutil.which(program) is None:
            return f"{program} (util-linux, iproute2) is not installed"
    tried = subprocess.run(["unshare", *_NAMESPACES, "--fork", "true"], capture_output=True)
    return f"no namespaces here: {tried.stderr.decode().strip()}" if tried.returncode else None


@dataclass
class Host:
    """A host: where to reach it, its home folder, and its first process, seen from outside."""

    name: str
    address: str
    home: Path
    first: int
    keeper: subprocess.Popen[bytes] = field(repr=False)

    def command(self, words: Sequence[str]) -> list[str]:
        """The command that runs ``words`` on this host."""
        return ["nsenter", f"--target={self.first}", *_NAMESPACES, "--", *words]

    def run(self, *words: str, **environment: str) -> str:
        """Run a command to its end; returns what it prints.

        Raises
        ------
        RuntimeError
            It fails; the message holds what it printed.
        """
        done = subprocess.run(
            self.command(words), env=self.environment(**environment), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"{self.name}: {' '.join(words)}: {done.stdout}")
        return done.stdout

    def environment(self, **more: str) -> dict[str, str]:
        """The environment of a command on this host."""
        return {**os.environ, "HOME": str(self.home), **more}

    def kill(self) -> None:
        """End the host at once, as a power cut does."""
        self.keeper.kill()  # unshare --kill-child takes the first process along
        self.keeper.wait()


@contextmanager
def hosts(names: Sequence[str], folder: Path) -> Iterator[list[Host]]:
    """Hosts of these names on one switch, 10.77.0.1 and so on; homes are made in ``folder``."""
    switch = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
    made: list[Host] = []
    try:
        _until(lambda: _namespace(switch.pid) != _namespace(os.getpid()))
        _on_switch(switch, "link", "add", "name", "switch0", "type", "bridge")
        _on_switch(switch, "link", "set", "switch0", "up")
        for number, name in enumerate(names, start=1):
            made.append(_host(name, f"10.77.0.{number}", folder))
            _plug_in(switch, made[-1])
        yield made
    finally:
        for host in made:
            host.kill()
        switch.kill()
        switch.wait()


def _host(name: str, address: str, folder: Path) -> Host:
    home = folder / name
    home.mkdir(parents=True)
    script = _FIRST_PROCESS.format(name=name, home=home)
    keeper = subprocess.Popen(
        ["unshare", *_NAMESPACES, "--fork", "--kill-child", "sh", "-ec", script]
    )
    _until((home / ".up").exists)
    children = Path(f"/proc/{keeper.pid}/task/{keeper.pid}/children").read_text()
    return Host(name, address, home, int(children), keeper)


def _plug_in(switch: subprocess.Popen[bytes], host: Host) -> None:
    """A cable from the switch to the host's card, and the card's address."""
    far = ("peer", "name", "eth0", "netns", str(host.first))
    _on_switch(switch, "link", "add", "name", host.name, "type", "veth", *far)
    _on_switch(switch, "link", "set", host.name, "master", "switch0", "up")
    host.run("ip", "address", "add", f"{host.address}/24", "dev", "eth0")
    host.run("ip", "link", "set", "eth0", "up")


def _on_switch(switch: subprocess.Popen[bytes], *words: str) -> None:
    subprocess.run(["nsenter", f"--target={switch.pid}", "--net", "ip", *words], check=True)


def _namespace(process: int) -> str:
    return os.readlink(f"/proc/{process}/ns/net")


def _until(happened, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not happened():
        if time.monotonic() > end:
            raise TimeoutError("a host does not come up")
        time.sleep(0.02)
