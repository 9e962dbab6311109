"""How much memory this process may still take: what the machine, its cgroup and `ulimit -v` leave.

A C library that is refused memory often ends the process with a signal. So the heavy ones are
loaded only where the address space that they need is free, and where it is limited they are asked
to take little of it.
"""

from __future__ import annotations

import ctypes
import os
import resource
from contextlib import suppress
from pathlib import Path

MEGABYTE = 1 << 20
# Read by OpenBLAS, OpenMP (torch, pyarrow), pyarrow's readers and tokenizers when they are loaded.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "ARROW_IO_THREADS", "RAYON_NUM_THREADS")
_M_ARENA_MAX = -8  # malloc.h: how many heaps threads may have
_CGROUPS = Path("/sys/fs/cgroup")


def address_space_limit() -> int | None:
    """Bytes of address space that the process may have (`ulimit -v`), if there is a limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def address_space_used() -> int:
    """Bytes of address space that the process has; 0 where the system does not say."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def available() -> int:
    """Bytes that the process may use: the least of what machine, cgroup and limits leave."""
    most = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), *_cgroup_limits()]
    limit = address_space_limit()
    if limit is not None:
        most.append(max(limit - address_space_used(), 0))
    return min(most)


def shortage(what: str, megabytes: int) -> str | None:
    """One line that says that something does not fit under `ulimit -v`; ``None`` where it does.

    Parameters
    ----------
    what : what is about to be loaded
    megabytes : the address space that it needs beside what the process has already
    """
    limit = address_space_limit()
    if limit is None:
        return None
    needed = address_space_used() // MEGABYTE + megabytes
    if needed * MEGABYTE <= limit:
        return None
    return (
        f"{what} needs about {needed} MB of address space, the limit is {limit // MEGABYTE} MB; "
        f"raise it (`ulimit -v {-(-needed // 100) * 102400}`), then run the command again"
    )


def spare_address_space() -> None:
    """Where `ulimit -v` is set, have libraries that are loaded later take little of it."""
    if address_space_limit() is None:
        return
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # its own maps 1 GB at once
    with suppress(OSError, AttributeError):  # of glibc: otherwise 64 MB a thread, used or not
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


def _cgroup_limits() -> list[int]:
    """Memory limits of the process's cgroup and those above it, in bytes; none where unknown."""
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        unified = not controllers
        if unified or "memory" in controllers.split(","):
            top = _CGROUPS if unified else _CGROUPS / "memory"
            name = "memory.max" if unified else "memory.limit_in_bytes"
            inner = top / path.lstrip("/")
            folders = [f for f in (inner, *inner.parents) if f.is_relative_to(top)]
            found += [limit for folder in folders if (limit := _number(folder / name))]
    return found


def _number(path: Path) -> int | None:
    try:
        text = path.read_text(encoding="ascii").strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None
