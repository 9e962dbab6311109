"""Commands on a full disk, without permission, and with little memory: one clear line each."""

import re
import shutil
import tempfile
from pathlib import Path

import pytest

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
        ("build", 0), ("build", 20_000), ("build again", 60_000), ("plan", 0), ("compact", 4096),
        ("rollback", 0), ("export", 0), ("export gz", 0), ("sql", 60_000), ("report", 4096),
        ("evaluate", 4096), ("labels", 4096),
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


def assert_matches(pattern, ended: Ended):
    assert re.search(pattern, ended.complained), ended.complained
