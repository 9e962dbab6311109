"""What the system and libraries refuse becomes one line; what is a bug stays one."""

import errno
import os
import resource

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from roomtables.errors import StoreError
from roomtables.storage.files import write_aside, writing
from roomtables.storage.refusals import refusal

FULL = "the disk is full"
# What each library says of a full disk, as it was said on one.
FULL_DISKS = [
    OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/tmp/x"),
    OSError(
        errno.ENOSPC, "Error writing bytes to file. Detail: [errno 28] No space left on device"
    ),
    OSError("1000000 requested and 25584 written"),
    duckdb.IOException('IO Error: Could not write file "/tmp/x/w.duckdb": No space left on device'),
    duckdb.TransactionException(
        'TransactionContext Error: Failed to commit: Could not write file "/tmp/x/w.duckdb": '
        "No space left on device"
    ),
    duckdb.FatalException("FATAL Error: invalidated: IO Error: No space left on device"),
    duckdb.OutOfMemoryException(
        "Out of Memory Error: failed to offload data block of size 256.0 KiB\n"
        "This limit was set by the 'max_temp_directory_size' setting."
    ),
]


@pytest.mark.parametrize("error", FULL_DISKS, ids=lambda error: type(error).__name__)
def test_a_full_disk_is_told_with_what_is_free_and_where(error, tmp_path):
    said = str(refusal(error, tmp_path))
    assert FULL in said
    assert " kB free in /" in said
    assert "free some space, then run the command again: what is scored is kept" in said
    assert "\n" not in said


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        pa.ArrowMemoryError("malloc of size 8 failed"),
        duckdb.OutOfMemoryException("Out of Memory Error: could not allocate block\nhints"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes"),
        RuntimeError("can't start new thread"),
        RuntimeError("std::bad_alloc"),
        ImportError("libtorch_cpu.so: failed to map segment from shared object"),
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
    ],
    ids=lambda error: f"{type(error).__name__}-{error}"[:40],
)
def test_a_lack_of_memory_says_what_to_lower(error):
    said = str(refusal(error))
    assert said.startswith("out of memory")
    assert "`-k`" in said
    assert "\n" not in said


def test_a_lack_of_memory_is_told_of_numpy_too():
    with pytest.raises(MemoryError) as raised:
        np.zeros(1 << 60, np.uint8)
    assert "Unable to allocate" in str(refusal(raised.value))


@pytest.mark.parametrize("number", sorted(errno.errorcode))
def test_every_refusal_of_the_system_is_a_line(number, tmp_path):
    error = OSError(number, os.strerror(number), str(tmp_path / "x"))
    said = str(refusal(error))
    assert "\n" not in said
    if number != errno.ENOMEM:
        assert str(tmp_path / "x") in said
        assert ";" in said  # and what to do


@pytest.mark.parametrize(
    "error",
    [
        ValueError("No space left on device"), KeyError("x"), TypeError("x"), AssertionError(),
        ImportError("No module named 'torch'"), RuntimeError("x"), ZeroDivisionError(),
        duckdb.BinderException("Binder Error: x"), duckdb.InternalException("INTERNAL Error: x"),
        duckdb.ConversionException("Conversion Error: x"), pa.ArrowInvalid("x"),
    ],
    ids=lambda error: type(error).__name__,
)  # fmt: skip
def test_a_bug_stays_a_bug(error):
    assert refusal(error) is None


def test_a_permission_says_whose(tmp_path):
    tmp_path.chmod(0o750)
    said = str(refusal(PermissionError(errno.EACCES, "x", str(tmp_path / "a" / "b")), doing="read"))
    owner = tmp_path.owner()
    assert f"cannot read {tmp_path}/a/b: permission denied ({tmp_path} belongs to {owner}" in said
    assert "mode 750" in said
    assert f"you are {owner}" in said


def test_writing_and_write_aside_speak_the_same_words(tmp_path):
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, most))
    try:
        with pytest.raises(StoreError, match=r"cannot write .*x: File too large.*ulimit -f"):
            write_aside(tmp_path / "x", b"a" * 100)
        with (
            pytest.raises(StoreError, match=r"cannot write .*y.*ulimit -f"),
            writing(tmp_path / "y"),
        ):
            (tmp_path / "y").write_bytes(b"a" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    assert not (tmp_path / "x").exists()
