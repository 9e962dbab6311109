"""Commands on a full disk, without permission, and with little memory: one clear line each."""

import os
import re
import shutil
import tempfile
from pathlib import Path

import click
import pytest

import roomtables
from limited import NOBODY, Ended, leave_room, may_mount, run_cold, run_warm, tmpfs
from roomtables import RoomTables, build
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

ROOMS = (
    '{"room_id": "1", "objects": ["bed", "sink"], "room": "bedroom"}\n'
    '{"room_id": "2", "objects": ["stove", "sink"], "room": "kitchen"}\n'
)
SIZES = (0, 4096, 8192, 20_000, 60_000, 100_000, 200_000, 400_000, 1_000_000, 2_000_000)
FULL = r"cannot write .*: the disk is full \([\d,]+ kB free in .*free some space"


@pytest.fixture(scope="module")
def root():
    """A folder that everybody may look into."""
    with tempfile.TemporaryDirectory(prefix="roomtables-test-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture(scope="module")
def built(root):
    """Tables of three versions and three score parts, and beside them labels and rooms."""
    labels = write_space(root / "labels", small_space())
    for k in (1, 2, 3):
        build(tables=root / "built", labels=str(labels), scorer=HashScorer(), k=k)
    (root / "rooms.jsonl").write_text(ROOMS)
    return root / "built"


@pytest.fixture
def mounted(root, built):
    """The tables on a file system of their own."""
    if not may_mount(root / "disk"):
        pytest.skip("this process may not mount a file system")
    with tmpfs(root / "disk", 64 << 20) as disk:
        shutil.copytree(built, disk / "t", copy_function=shutil.copyfile)
        yield disk


def commands(root, disk, out):
    """Every command by name: on tables in ``disk``, writing what it is told to into ``out``."""
    tables, labels = ("--tables", disk / "t"), ("--labels", "small")
    of_folder = ("--labels", root / "labels" / "small")
    return {
        "build": ("build", *tables, *of_folder, "--full-refresh"),
        "build again": ("build", *tables, *of_folder, "-k", 2, "--smoothing", 0.5),
        "plan": ("plan", *tables, *of_folder, "--smoothing", 0.7),
        "compact": ("compact", *tables),
        "gc": ("gc", *tables, "--keep", 1),
        "rollback": ("rollback", *tables, *labels),
        "export": ("export", *tables, *labels, "-o", out / "x.tar.zst"),
        "export gz": ("export", *tables, *labels, "-o", out / "x.tar.gz"),
        "classify": ("classify", *tables, *labels, "bed", "sink", "-o", out / "classified"),
        "misses": ("misses", *tables, *labels, "-o", out / "misses"),
        "sql": ("sql", "from query_scores, range(99)", *tables, *labels, "-o", out / "answer"),
        "status": ("status", "--verify", *tables, *labels, "-o", out / "status"),
        "diff": ("diff", *tables, *labels, "-o", out / "changes"),
        "report": ("report", *tables, *labels, "-o", out / "page.html"),
        "evaluate": ("evaluate", root / "rooms.jsonl", *tables, *labels, "--plot", out / "p.svg"),
        "labels": ("labels", "from-rooms", root / "rooms.jsonl", "-o", out / "space"),
    }  # fmt: skip


def check_published(tables):
    """Check that what is published is whole and answers."""
    SpaceFolder(tables, "small").current().verify()
    opened = RoomTables.open(tables, "small", rule="pooled", offline=True)
    assert opened.classify(["bed", "sink"]).room


def assert_matches(pattern, ended: Ended):
    assert re.search(pattern, ended.complained), ended.complained


def on_a_full_disk(root, disk, name, room):
    """Run a command with so many bytes left; then again, with enough. Returns the first end."""
    args = commands(root, disk, disk)[name]
    leave_room(disk, room)
    ended = run_warm(args, root / "said", TMPDIR=str(disk))
    ended.check()
    leave_room(disk, 64 << 20)
    check_published(disk / "t")
    assert not [path.name for path in disk.rglob(".*") if path.name != ".build-lock"]
    if ended.code:
        assert run_warm(args, root / "said").code == 0
        check_published(disk / "t")
    return ended


@pytest.mark.parametrize(
    ("name", "room"),
    [
        ("build", 0), ("build again", 60_000), ("compact", 4096), ("rollback", 0), ("export", 0),
        ("sql", 60_000), ("labels", 4096),
    ],
)  # fmt: skip
def test_a_full_disk_is_one_line(root, mounted, name, room):
    ended = on_a_full_disk(root, mounted, name, room)
    assert ended.code == 1
    assert_matches(FULL, ended)


@pytest.mark.faults
@pytest.mark.parametrize("room", SIZES)
@pytest.mark.parametrize("name", commands(Path(), Path(), Path()))
def test_every_command_on_a_disk_of_every_size(root, mounted, name, room):
    ended = on_a_full_disk(root, mounted, name, room)
    if ended.code:
        assert_matches(FULL, ended)


@pytest.mark.faults
@pytest.mark.parametrize("size", [60_000, 100_000, 200_000, 400_000, 800_000, 1_600_000, 2_000_000])
def test_the_first_build_of_a_real_label_space_on_a_small_disk(root, size):
    if not may_mount(root / "disk"):
        pytest.skip("this process may not mount a file system")
    with tmpfs(root / "disk", size) as disk:
        args = ("build", "--tables", disk / "t", "--labels", "mpcat40", "-k", 2)
        ended = run_warm(args, root / "said")
        ended.check()
        assert not list(disk.rglob(".staging-*"))
        leave_room(disk, 64 << 20)
        assert run_warm(args, root / "said").code == 0
        SpaceFolder(disk / "t", "mpcat40").current().verify()


# What may not be read or written, by the command that needs it.
READING = ("classify", "misses", "sql", "status", "diff", "report", "evaluate")
WRITING = ("build", "build again", "compact", "gc", "rollback")


@pytest.fixture
def copied(root, built):
    """A copy of the tables, which the tests may lock up; unlocked at the end."""
    folder = root / "copy"
    shutil.copytree(built, folder / "t")
    yield folder
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)
    shutil.rmtree(folder)


@pytest.mark.parametrize("name", WRITING)
def test_a_read_only_folder_is_one_line(root, copied, name):
    for path in (copied / "t", *(copied / "t").rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    ended = run_warm(commands(root, copied, copied)[name], root / "said")
    assert ended.check().startswith("error: cannot write ")
    denied = r"permission denied \(.* belongs to \w+, mode 5?[45]{3}; you are \w+\); ask \w+ for"
    assert_matches(denied, ended)
    check_published(copied / "t")


@pytest.mark.faults
@pytest.mark.parametrize("name", [*READING, "plan", "export"])
def test_a_read_only_folder_can_be_read(root, copied, name, tmp_path):
    for path in (copied / "t", *(copied / "t").rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    ended = run_warm(commands(root, copied, tmp_path)[name], root / "said")
    assert (ended.code, ended.complained.count("error")) == (0, 0), ended


UNREADABLE = {
    "scores/hash@1/part-*": "build again",
    "scores/hash@1": "build again",
    "scores": "sql",
    "small/CURRENT": "status",
    "small/0*/manifest.json": "classify",
    "small/0*/lookup/lookup.json": "classify",
    "small/0*/entropy.parquet": "diff",
    "small": "misses",
    "small/0*": "export",
}


@pytest.mark.parametrize("which", UNREADABLE)
def test_what_may_not_be_read_is_not_called_damaged(root, copied, which, tmp_path):
    locked = max((copied / "t").glob(which))
    locked.chmod(0)
    ended = run_warm(commands(root, copied, tmp_path)[UNREADABLE[which]], root / "said")
    said = ended.check()
    assert ended.code == 1
    assert "permission denied" in said.lower()
    assert str(locked) in said
    for wrong in ("damaged", "remove it", "is not there"):
        assert wrong not in said
    locked.chmod(0o755)
    check_published(copied / "t")


def test_a_label_space_that_may_not_be_read_is_one_line(root, copied):
    folder = write_space(copied / "labels", small_space())
    folder.chmod(0)
    ended = run_warm(("build", "--tables", copied / "t", "--labels", folder), root / "said")
    assert ended.check().startswith("error: cannot ")
    assert "ermission denied" in ended.complained


def test_another_user_is_told_whose_a_file_is(root, copied):
    if not may_become_nobody():
        pytest.skip("needs root, and a checkout that everybody may read")
    part = max((copied / "t").glob("scores/hash@1/part-*"))
    part.chmod(0o600)
    ended = run_warm(("compact", "--tables", copied / "t"), root / "said", user=NOBODY)
    assert ended.check().startswith("error: cannot ")
    assert "belongs to root, mode " in ended.complained
    assert "you are nobody" in ended.complained


def may_become_nobody():
    """Whether a child may become another user, and then still find the package."""
    files = [Path(module.__file__).resolve() for module in (roomtables, os, click)]
    modes = [folder.stat().st_mode for file in files for folder in file.parents]
    return os.geteuid() == 0 and all(mode & 0o005 == 0o005 for mode in modes)


MEMORY_COMMANDS = ("compact", "sql", "diff", "classify", "export", "gc", "status")


@pytest.mark.parametrize(("name", "most"), [("compact", 300), ("sql", 400), ("diff", 500)])
def test_little_address_space_is_one_line_or_enough(root, copied, name, most):
    """One of them once crashed at each of these limits."""
    with_little_address_space(root, copied, name, most)


@pytest.mark.faults
@pytest.mark.parametrize("most", [200, 300, 350, 400, 450, 500, 550, 600, 700, 800, 900, 1000])
@pytest.mark.parametrize("name", MEMORY_COMMANDS)
def test_every_command_in_every_address_space(root, copied, name, most):
    with_little_address_space(root, copied, name, most)


def with_little_address_space(root, copied, name, most):
    ended = run_cold(commands(root, copied, copied)[name], most)
    ended.check()
    if ended.code:
        assert_matches(r"about \d+ MB of address space, the limit is \d+ MB.*ulimit -v \d+", ended)
    check_published(copied / "t")
    assert not ended.code or most < 520  # it is enough for all of them


def test_a_model_that_does_not_fit_is_one_line(root, copied):
    tables = ("--tables", copied / "t", "--labels", root / "labels" / "small")
    ended = run_cold(("build", *tables, "--dtype", "float64"), 700)  # which asks for torch
    assert ended.code == 1
    assert "a language model needs about " in ended.check()
    check_published(copied / "t")


@pytest.mark.faults
@pytest.mark.parametrize("most", [400, 500, 600, 700, 800, 900, 1000, 1200])
def test_a_model_in_every_address_space(root, copied, most):
    tables = ("--tables", copied / "t", "--labels", root / "labels" / "small")
    run_cold(("build", *tables, "--dtype", "float64"), most).check()
    run_cold(("build", *tables, "--full-refresh"), most).check()
    run_cold(("classify", *tables[:2], "--labels", "small", "bed", "zebra"), most).check()
    check_published(copied / "t")
