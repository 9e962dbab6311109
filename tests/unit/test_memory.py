"""How much memory is left."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

from roomtables.memory import available, free


def test_what_is_free_is_part_of_what_the_process_may_use() -> None:
    assert 0 < free() <= available()


def test_what_is_free_is_no_more_than_the_system_says() -> None:
    psutil = pytest.importorskip("psutil")
    assert free() < 1.5 * psutil.virtual_memory().available


def test_under_a_limit_of_address_space() -> None:
    limit = 400 << 20
    code = "from roomtables.memory import free; print(free())"
    found = subprocess.run(
        [sys.executable, "-c", code],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(found.stdout) < limit
