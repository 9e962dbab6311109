"""When a build last found everything up to date: noted by builds, read by `status`."""

import os
from datetime import UTC, datetime, timedelta, timezone

import pytest

from roomtables import RoomTables, build
from roomtables.errors import StoreError
from roomtables.offline.upkeep import collect_garbage, roll_back
from roomtables.storage.checked import CHECKED, last_checked, note_checked
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

MOMENT = datetime(2026, 11, 25, 2, 31, 7, tzinfo=UTC)


@pytest.fixture
def labels(tmp_path):
    return str(write_space(tmp_path / "labels", small_space()))


@pytest.fixture
def tables(tmp_path):
    return tmp_path / "tables"


def made(tables, labels, **options):
    build(tables=tables, labels=labels, scorer=HashScorer(), k=1, **options)
    return SpaceFolder(tables, "small").current()


def test_a_build_that_finds_everything_up_to_date_notes_it(tables, labels):
    version = made(tables, labels)
    assert not (version.path.parent / CHECKED).exists()
    assert last_checked(version) is None
    before = datetime.now(UTC)
    assert made(tables, labels) == version
    moment, name = (version.path.parent / CHECKED).read_text().split()
    assert name == version.name
    assert before - timedelta(seconds=1) <= datetime.fromisoformat(moment) <= datetime.now(UTC)
    assert last_checked(version) == datetime.fromisoformat(moment)


def test_what_was_noted_of_another_version_does_not_count(tables, labels):
    first = made(tables, labels)
    made(tables, labels)
    second = made(tables, labels, reduction="mean")
    assert last_checked(second) is None
    assert last_checked(first) is not None
    assert roll_back(tables, "small")[1] == first


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\n", b"nonsense", b"\xff\xfe", b"2026-11-25T02:31:07 {name}", b"{name}",
        b"2026-11-25T02:31:07+00:00", b"2026-11-25T02:31:07+00:00 {name} more",
        b"9999-12-31T23:59:59-14:00 {name}", b"0001-01-01T00:00:00+14:00 {name}",
        b"2026-11-25T02:31:07+00:00 " + b"x" * 5000,
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_no_error(tables, labels, content):
    version = made(tables, labels)
    path = version.path.parent / CHECKED
    path.write_bytes(content.replace(b"{name}", version.name.encode()))
    assert last_checked(version) is None
    assert RoomTables.open(tables, "small", offline=True).classify(["bed"]).room
    assert collect_garbage(tables) == []
    made(tables, labels)  # and the next build writes it anew
    assert last_checked(version) is not None


def test_no_folder_and_no_pipe_is_read(tables, labels):
    version = made(tables, labels)
    path = version.path.parent / CHECKED
    path.mkdir()
    assert last_checked(version) is None
    path.rmdir()
    os.mkfifo(path)
    assert last_checked(version) is None


def test_another_time_zone_is_the_same_moment(tables, labels):
    version = made(tables, labels)
    note_checked(version, MOMENT.astimezone(timezone(timedelta(hours=-7))))
    assert last_checked(version) == MOMENT
    assert (version.path.parent / CHECKED).read_text().count("\n") == 1


def test_garbage_collection_leaves_it(tables, labels):
    version = made(tables, labels)
    note_checked(version, MOMENT)
    (version.path.parent / ".CHECKED.0123abcd.tmp").write_text("half")
    assert [row.path for row in collect_garbage(tables)] == ["small/.CHECKED.0123abcd.tmp"]
    assert last_checked(version) == MOMENT


def test_it_is_not_written_through_a_link_out_of_the_tables(tables, labels, tmp_path):
    version = made(tables, labels)
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    (version.path.parent / CHECKED).symlink_to(mine)
    with pytest.raises(StoreError, match="symbolic link out of"):
        made(tables, labels)
    assert mine.read_text() == "mine"
