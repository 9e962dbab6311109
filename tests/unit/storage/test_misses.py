"""Misses are noted by many processes, survive crashes, stay bounded, and are taken in once."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from roomtables.storage import miss_log, misses
from roomtables.storage.miss_log import MissLog
from roomtables.storage.misses import Misses


def asked(folder: Path) -> dict[tuple[str, ...], int]:
    return {miss.objects: miss.times_asked for miss in Misses.read(folder).open}


def test_what_is_noted_is_counted(tmp_path: Path) -> None:
    folder = tmp_path / "misses"
    log = MissLog(folder)
    log.note("proxy", [("bed", "lamp"), ("sink",)])
    log.note("proxy", [("bed", "lamp")])
    log.note("ground_truth", [("bed", "lamp")])
    log.note("proxy", [])
    found = Misses.read(folder).open
    assert [(m.source, m.objects, m.times_asked) for m in found] == [
        ("proxy", ("bed", "lamp"), 2),
        ("ground_truth", ("bed", "lamp"), 1),
        ("proxy", ("sink",), 1),
    ]
    assert all(datetime.now(timezone.utc) - m.last_asked < timedelta(minutes=1) for m in found)


def test_no_folder_is_no_misses(tmp_path: Path) -> None:
    assert Misses.read(tmp_path / "misses").open == ()


def test_a_torn_line_costs_only_itself(tmp_path: Path) -> None:
    log = MissLog(tmp_path)
    log.note("proxy", [("bed",)])
    (path,) = tmp_path.glob("*.jsonl")
    with path.open("ab") as file:
        file.write(b'{"source": "proxy", "obj')
    assert asked(tmp_path) == {("bed",): 1}
    log.note("proxy", [("sink",)])
    assert asked(tmp_path) == {("bed",): 1, ("sink",): 1}


@pytest.mark.parametrize(
    "line",
    [
        b"\xff\xfe", b"[]", b"null", b"{}", b"5", b'{"source": 1, "objects": ["a"], "asked": "x"}',
        b'{"source": "proxy", "objects": "bed", "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": "proxy", "objects": [], "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": "proxy", "objects": [3], "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": "proxy", "objects": ["a", "b"], "asked": "0001-01-01T00:00:00+14:00"}',
        b'{"source": "proxy", "objects": ["a"], "asked": "9999-12-31T23:59:59-14:00"}',
        b'{"source": "proxy", "objects": ["a"], "asked": 1e999}',
        b'{"source": "proxy", "objects": ["\\ud800"], "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": "gossip", "objects": ["a"], "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": ["proxy"], "objects": ["a"], "asked": "2026-01-01T00:00:00+00:00"}',
        b'{"source": "proxy", "objects": ["%s"], "asked": "2026-01-01"}' % (b"x" * 10_001),
        b'{"source": "proxy", "objects": [%s"a"], "asked": "2026-01-01"}' % (b'"a",' * 8),
        b"1" * 5000, b"[" * 60_000, b"x" * 200_000,
    ],
)  # fmt: skip
def test_lines_that_are_no_misses_are_skipped_counted_and_named_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, line: bytes
) -> None:
    good = b'{"source": "proxy", "objects": ["bed"], "asked": "2026-01-01T00:00:00+00:00"}'
    path = tmp_path / "robot-1.jsonl"
    path.write_bytes(line + b"\n" + line + b"\n\n" + good + b"\n")
    assert asked(tmp_path) == {("bed",): 1}
    (said,) = [record.getMessage() for record in caplog.records]
    assert said.startswith(f"{path}: lines that are no misses: 2, such as the one at byte 0: ")
    assert len(said) < len(str(path)) + 200
    Misses.read(tmp_path).take_in()
    caplog.clear()
    assert asked(tmp_path) == {}
    assert not caplog.records  # what was read is not read again


def test_pipes_and_files_without_a_name_in_text_are_no_misses(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.jsonl")
    (tmp_path / os.fsdecode(b"robot-\xff.jsonl")).write_bytes(b"x\n")
    MissLog(tmp_path).note("proxy", [("bed",)])
    assert asked(tmp_path) == {("bed",): 1}
    Misses.read(tmp_path).take_in()


def test_taken_in_is_listed_no_more_and_what_comes_later_is(tmp_path: Path) -> None:
    log = MissLog(tmp_path)
    log.note("proxy", [("bed",)])
    read = Misses.read(tmp_path)
    log.note("proxy", [("sink",)])  # while the build runs
    read.take_in()
    later = Misses.read(tmp_path)
    assert asked(tmp_path) == {("sink",): 1}
    assert later.taken == {("proxy", ("bed",))}
    later.take_in()
    assert Misses.read(tmp_path).open == ()
    assert Misses.read(tmp_path).taken == {("proxy", ("bed",)), ("proxy", ("sink",))}


def test_files_read_and_idle_are_removed(tmp_path: Path) -> None:
    MissLog(tmp_path).note("proxy", [("bed",)])
    (path,) = tmp_path.glob("*.jsonl")
    Misses.read(tmp_path).take_in()
    assert path.exists()  # its process may write again at any moment
    os.utime(path, (time.time() - 7200,) * 2)
    Misses.read(tmp_path).take_in()
    assert not path.exists()
    MissLog(tmp_path).note("proxy", [("sink",)])  # the same name again
    assert asked(tmp_path) == {("sink",): 1}


def test_what_no_table_can_hold_is_not_remembered(tmp_path: Path) -> None:
    log = MissLog(tmp_path)
    log.note("proxy", [("bed",), *[(f"junk {n}",) for n in range(500)]])
    Misses.read(tmp_path).take_in(known={"bed", "sink"})
    assert asked(tmp_path) == {}
    assert Misses.read(tmp_path).taken == {("proxy", ("bed",))}
    assert (tmp_path / "taken.json").stat().st_size < 200


def test_what_is_remembered_is_bounded_and_the_most_asked_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(misses, "TAKEN", 2)
    log = MissLog(tmp_path)
    log.note("proxy", [("bed",), ("sink",), ("lamp",), ("lamp",), ("sink",)])
    Misses.read(tmp_path).take_in()
    assert Misses.read(tmp_path).taken == {("proxy", ("lamp",)), ("proxy", ("sink",))}
    assert "2 of 3 combinations are remembered" in caplog.text
    assert asked(tmp_path) == {}  # taken in all the same


def test_a_crash_before_a_file_is_removed_does_not_open_its_misses_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    MissLog(tmp_path).note("proxy", [("bed",)])
    (path,) = tmp_path.glob("*.jsonl")
    os.utime(path, (time.time() - 7200,) * 2)

    def crash(_: Path) -> None:
        raise KeyboardInterrupt

    found = Misses.read(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", crash)
        with pytest.raises(KeyboardInterrupt):
            found.take_in()
    assert path.exists()
    assert asked(tmp_path) == {}
    Misses.read(tmp_path).take_in()
    assert not path.exists()


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        '{"read": {"x": 1e999}, "combinations": []}',
        '{"read": {}, "combinations": [["proxy", "\\ud800"]]}',
        '{"read": 3}',
        '{"read": {}, "combinations": 7}',
    ],
)
def test_a_damaged_note_of_what_was_read_means_read_again(tmp_path: Path, content: str) -> None:
    MissLog(tmp_path).note("proxy", [("bed",)])
    (tmp_path / "taken.json").write_text(content, encoding="utf-8")
    assert asked(tmp_path) == {("bed",): 1}


def test_files_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(miss_log, "FILE_BYTES", 1000)
    log = MissLog(tmp_path)
    for _ in range(100):
        log.note("proxy", [("bed", "lamp")])
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 1000
    assert len(caplog.records) == 1
    assert "not noted" in caplog.text


def test_folders_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "other-1.jsonl").write_bytes(b"\n" * 100)
    monkeypatch.setattr(miss_log, "FOLDER_BYTES", 99)
    MissLog(tmp_path).note("proxy", [("bed",)])
    assert asked(tmp_path) == {}
    assert "not noted" in caplog.text


@pytest.mark.parametrize("failure", [errno.EROFS, errno.EACCES, errno.ENOSPC])
def test_what_cannot_be_written_is_warned_of_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, failure: int
) -> None:
    def refuse(*_: object, **__: object) -> int:
        raise OSError(failure, os.strerror(failure))

    monkeypatch.setattr(os, "open", refuse)
    log = MissLog(tmp_path)
    for _ in range(3):
        log.note("proxy", [("bed",)])
    assert [record.getMessage() for record in caplog.records] == [
        f"misses are not noted in {tmp_path}: {os.strerror(failure)}"
    ]


def test_a_full_disk_leaves_a_torn_line_and_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    log = MissLog(tmp_path)
    log.note("proxy", [("bed",)])
    whole = miss_log.FileIO.write

    class Full(miss_log.FileIO):
        def write(self, data: object) -> int:
            return whole(self, bytes(data)[:7])  # type: ignore[call-overload]

    with monkeypatch.context() as patched:
        patched.setattr(miss_log, "FileIO", Full)
        log.note("proxy", [("sink",)])
    log.note("proxy", [("lamp",)])
    assert asked(tmp_path) == {("bed",): 1, ("lamp",): 1}
    assert "the disk is full" in caplog.text


def test_threads_and_processes_note_at_once_while_a_build_reads(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from roomtables.storage.miss_log import MissLog\n"
        "log = MissLog(Path(sys.argv[1]))\n"
        "for _ in range(200): log.note('proxy', [('bed', sys.argv[2])])"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    processes = [subprocess.Popen([*command, f"object {n}"]) for n in range(3)]
    log = MissLog(tmp_path)
    work = [
        threading.Thread(target=lambda: [log.note("proxy", [("lamp",)]) for _ in range(200)])
        for _ in range(2)
    ]
    for thread in work:
        thread.start()
    taken = 0
    while any(process.poll() is None for process in processes):
        read = Misses.read(tmp_path)
        taken += sum(miss.times_asked for miss in read.open)
        read.take_in()
        time.sleep(0.02)
    for thread in work:
        thread.join()
    assert [process.returncode for process in processes] == [0, 0, 0]
    taken += sum(miss.times_asked for miss in Misses.read(tmp_path).open)
    assert taken == 3 * 200 + 2 * 200
    for path in tmp_path.glob("*.jsonl"):
        assert all(json.loads(line) for line in path.read_bytes().splitlines())
