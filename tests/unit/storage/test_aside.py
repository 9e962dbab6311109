"""Files written aside: what they take the place of, and what a killed process leaves."""

import os
import stat
import threading
from pathlib import Path

import pytest

from roomtables.errors import StoreError
from roomtables.storage.aside import asides, remove_abandoned, remove_folder, replacing
from roomtables.storage.files import held, write_aside
from roomtables.storage.scratch import scratch


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_nothing_is_left_and_nothing_changes_where_writing_fails(tmp_path):
    path = tmp_path / "x"
    write_aside(path, b"old")

    def fail():
        with replacing(path) as aside:
            aside.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["x"]


def test_the_next_write_removes_what_a_killed_one_left_and_nothing_else(tmp_path):
    path = tmp_path / "x[1].txt"
    left = [".x[1].txt.0123abcd.tmp", ".x[1].txt.77.tmp"]
    others = [".x[1].txt.notes.tmp", ".y.0123abcd.tmp", "x1.txt.0123abcd.tmp"]
    for name in left + others:
        (tmp_path / name).write_bytes(b"half")
    write_aside(path, b"new")
    assert names(tmp_path) == sorted([*others, path.name])
    assert [found.name for found in asides(tmp_path)] == [".y.0123abcd.tmp"]


def test_a_file_that_is_being_written_is_not_taken_for_left_over(tmp_path):
    path = tmp_path / "x"
    with replacing(path) as slow:
        slow.write_bytes(b"slow")
        write_aside(path, b"quick")
        assert not remove_abandoned(slow)
        assert path.read_bytes() == b"quick"
    assert path.read_bytes() == b"slow"
    assert names(tmp_path) == ["x"]


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    target, link, loose = tmp_path / "target", tmp_path / "link", tmp_path / "loose"
    target.write_bytes(b"old")
    link.symlink_to("target")
    loose.symlink_to("made")
    for path in (link, loose):
        write_aside(path, b"new")
        assert path.is_symlink()
    assert target.read_bytes() == (tmp_path / "made").read_bytes() == b"new"


def test_pipes_and_devices_are_written_through(tmp_path):
    pipe, device = tmp_path / "pipe", tmp_path / "device"
    os.mkfifo(pipe)
    device.symlink_to("/dev/null")
    heard = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    write_aside(pipe, b"said")
    reader.join()
    write_aside(device, b"lost")
    assert heard == [b"said"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert (device.is_symlink(), device.is_char_device()) == (True, True)
    assert names(tmp_path) == ["device", "pipe"]


def test_what_this_process_has_open_is_written_through(tmp_path):
    """As ``-o /dev/stdout`` where the standard output is a file."""
    with (tmp_path / "x").open("wb") as file:
        write_aside(Path(f"/proc/self/fd/{file.fileno()}"), b"said")
        assert os.fstat(file.fileno()).st_size == 4


def test_a_link_to_itself_is_one_line(tmp_path):
    (tmp_path / "x").symlink_to("x")
    with pytest.raises(StoreError, match="cannot write"):
        write_aside(tmp_path / "x", b"")


def test_a_folder_goes_from_its_name_first(tmp_path):
    (tmp_path / "v" / "inner").mkdir(parents=True)
    (tmp_path / ".removing-v" / "half").mkdir(parents=True)
    remove_folder(tmp_path / "v")
    assert names(tmp_path) == []


def test_temporary_folders_of_killed_processes_go(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with scratch("plan") as one, scratch("plan") as other:
        (one / "x").write_text("x")
        assert one != other
        assert names(tmp_path) == sorted([one.name, other.name])
    assert names(tmp_path) == []
    left, theirs = tmp_path / "roomtables-plan-0123abcd", tmp_path / "roomtables-plan-mynotes1"
    left.mkdir(mode=0o700)
    (left / "work.duckdb").write_text("half")
    theirs.mkdir(mode=0o755)
    (tmp_path / "roomtables-plan-linked_1").symlink_to(theirs)
    with scratch("plan"):
        assert not left.exists()
    assert names(tmp_path) == ["roomtables-plan-linked_1", "roomtables-plan-mynotes1"]
    left.mkdir(mode=0o700)
    with held(left), scratch("plan"):
        assert left.exists()
