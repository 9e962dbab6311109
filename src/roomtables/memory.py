"""How much memory this process may still take: what the machine, its cgroup and `ulimit -v` leave.

A C library that is refused memory often ends the process with a signal. So the heavy ones are
loaded only where the address space that they need is free, and where it is limited they are asked
to take little of it.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
from contextlib import suppress
from pathlib import Path

MEGABYTE = 1 << 20
# Read by OpenBLAS, OpenMP (torch, pyarrow), pyarrow's readers and tokenizers when they are loaded.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "ARROW_IO_THREADS", "RAYON_NUM_THREADS")
_M_ARENA_MAX = -8  # malloc.h: how many heaps threads may have
_CGROUPS = Path("/sys/fs/cgroup")
_FREE = re.compile(r"^MemAvailable: +([0-9]+) kB$", re.MULTILINE)
_HELD = re.compile(r"^((?:total_)?(?:in)?active_file) ([0-9]+)$", re.MULTILINE)


def address_space_limit() -> int | None:
    """Bytes of address space that the process may have (`ulimit -v`), if there is a limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def address_space_used() -> int:
    """Bytes of address space that the process has; 0 where the system does not say."""
    pages = _content(Path("/proc/self/statm")).split()
    return int(pages[0]) * os.sysconf("SC_PAGE_SIZE") if pages else 0


def available() -> int:
    """Bytes that the process may use: the least of what machine, cgroup and limits leave."""
    most = [
        os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        *(limit for _, limit in _cgroup_limits()),
    ]
    limit = address_space_limit()
    if limit is not None:
        most.append(max(limit - address_space_used(), 0))
    return min(most)


def free() -> int:
    """Bytes that are free now: the least of what machine, cgroup and limits leave.

    What the system holds in memory of files counts as free, since it gives that up when asked.
    """
    left = [available()]
    left += [limit - _cgroup_used(folder) for folder, limit in _cgroup_limits()]
    found = _FREE.search(_content(Path("/proc/meminfo")))
    if found:
        left.append(int(found[1]) << 10)
    return max(0, min(left))


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


def _cgroup_limits() -> list[tuple[Path, int]]:
    """The process's cgroup and those above it that limit memory, and to how many bytes."""
    found = []
    for line in _content(Path("/proc/self/cgroup")).splitlines():
        _, controllers, path = line.split(":", 2)
        unified = not controllers
        if unified or "memory" in controllers.split(","):
            top = _CGROUPS if unified else _CGROUPS / "memory"
            name = "memory.max" if unified else "memory.limit_in_bytes"
            inner = top / path.lstrip("/")
            folders = [f for f in (inner, *inner.parents) if f.is_relative_to(top)]
            found += [(f, limit) for f in folders if (limit := _number(f / name))]
    return found


def _cgroup_used(folder: Path) -> int:
    """Bytes of memory that a cgroup's processes use, without what is held of files."""
    used = _number(folder / "memory.current") or _number(folder / "memory.usage_in_bytes") or 0
    held = {name: int(size) for name, size in _HELD.findall(_content(folder / "memory.stat"))}
    whole = [size for name, size in held.items() if name.startswith("total_")]  # with inner ones
    return max(0, used - sum(whole or held.values()))


def _number(path: Path) -> int | None:
    text = _content(path).strip()
    return int(text) if text.isdigit() else None


def _content(path: Path) -> str:
    """Text of a file of the system; empty where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
