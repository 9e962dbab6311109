"""Builds that are killed, interrupted, run twice at once, or run out of disk."""

import logging
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
import textwrap
from contextlib import suppress
from pathlib import Path

import pytest

from faults import run_faults
from roomtables import build
from roomtables.errors import RoomtablesError, StoreError
from roomtables.storage.files import build_lock
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

TESTS = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def labels(tmp_path_factory):
    return str(write_space(tmp_path_factory.mktemp("labels"), small_space()))


@pytest.fixture(scope="module")
def built(tmp_path_factory, labels):
    """Tables of two builds, so that there are two versions and two score parts."""
    tables = tmp_path_factory.mktemp("built")
    for k in (1, 3):
        build(tables=tables, labels=labels, scorer=HashScorer(), k=k)
    return tables


@pytest.fixture
def tables(built, tmp_path):
    """Those tables, to damage."""
    return shutil.copytree(built, tmp_path / "t")


@pytest.fixture
def start():
    """Start a child that runs some code and says "ready" once it is under way."""
    children = []

    def child(code, *args):
        paths = [str(TESTS), str(TESTS.parent / "src"), os.environ.get("PYTHONPATH", "")]
        process = subprocess.Popen(
            [sys.executable, "-c", DEFAULT_SIGNALS + textwrap.dedent(code), *map(str, args)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        )
        children.append(process)
        assert process.stdout.readline() == "ready\n", process.communicate()[1]
        return process

    yield child
    for process in children:
        with process:
            process.kill()


# A background job of a shell ignores SIGINT, and so would its children.
DEFAULT_SIGNALS = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
"""
# Holds the build lock until its standard input is closed.
HOLD = """
    import pathlib, sys
    from roomtables.storage.files import build_lock
    with build_lock(pathlib.Path(sys.argv[1])):
        print("ready", flush=True)
        sys.stdin.read()
"""
# The command line with a model that gives five scores and then takes for ever.
STUCK = """
    import sys, time
    import roomtables.lm
    from support import HashScorer

    class Stuck(HashScorer):
        def score_stream(self, sentences):
            for number, score in enumerate(super().score_stream(sentences)):
                if number == 5:
                    print("ready", flush=True)
                    time.sleep(600)
                yield score

    roomtables.lm.identify = lambda *args, **settings: "hash@1"
    roomtables.lm.load_scorer = lambda *args, **settings: Stuck()
    from roomtables.cli import main
    main(["build", "--tables", sys.argv[1], "--labels", sys.argv[2]])
"""


def test_killed_builds_lose_nothing_and_readers_never_notice(tmp_path):
    done = run_faults(tmp_path, kills=3, seed=2)
    assert done["kills"] == 3
    assert done["looks"] > 0


@pytest.mark.faults
def test_many_killed_builds_lose_nothing_and_readers_never_notice(tmp_path):
    done = run_faults(tmp_path, kills=25, seed=1)
    assert done["kills"] == 25
    assert done["half_written"] > 4
    assert done["looks"] > 25


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_build_keeps_what_it_scored(tmp_path, labels, start, number):
    process = start(STUCK, tmp_path / "t", labels)
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert said.splitlines()[-1] == "interrupted; what is scored is kept"
    assert "Traceback" not in said
    scorer = HashScorer()
    report = build(tables=tmp_path / "t", labels=labels, scorer=scorer)
    assert report.sentences_cached == 5
    assert len(scorer.asked) == 46 - 5
    assert list((tmp_path / "t" / "small").glob(".staging-*")) == []


def test_the_second_build_says_who_holds_the_lock(tmp_path, labels, start):
    process = start(HOLD, tmp_path)
    said = rf"is being built by process {process.pid} on .* since 20.*--wait"
    with pytest.raises(StoreError, match=said):
        build(tables=tmp_path, labels=labels, scorer=HashScorer())
    process.kill()
    process.wait()
    # What a dead process left in the lock file locks nothing.
    assert f"process {process.pid}" in (tmp_path / ".build-lock").read_text()
    assert build(tables=tmp_path, labels=labels, scorer=HashScorer()).published
    assert (tmp_path / ".build-lock").read_text() == ""


def test_the_second_build_waits_when_asked(tmp_path, labels, start):
    process = start(HOLD, tmp_path)

    class Release(logging.Handler):
        """Lets the holder go when the build says that it waits."""

        def emit(self, record):
            if "waiting for it" in record.getMessage():
                process.stdin.close()

    handler = Release()
    logging.getLogger("roomtables").addHandler(handler)
    try:
        report = build(tables=tmp_path, labels=labels, scorer=HashScorer(), wait=True)
    finally:
        logging.getLogger("roomtables").removeHandler(handler)
    assert process.stdin.closed
    assert process.wait() == 0
    assert report.published


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_named(tmp_path, labels):
    tables = tmp_path / "t"
    tables.mkdir()
    tables.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(StoreError, match=r"cannot write .*permission denied.*--tables DIR"):
        build(tables=tables, labels=labels, scorer=HashScorer())


def test_a_file_where_a_folder_should_be(tmp_path, labels):
    (tmp_path / "t").write_text("")
    with pytest.raises(StoreError, match="cannot write"):
        build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    (tmp_path / "u").mkdir()
    (tmp_path / "u" / "small").write_text("")
    with pytest.raises(StoreError, match="cannot write"):
        build(tables=tmp_path / "u", labels=labels, scorer=HashScorer())


@pytest.mark.parametrize("size", [0, 1000, 4000])
def test_a_disk_that_is_full_publishes_nothing(tables, labels, size):
    before = SpaceFolder(tables, "small").current().name
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        with pytest.raises(StoreError, match=r"cannot .*(again|writable)"):
            build(tables=tables, labels=labels, scorer=HashScorer("hash@2"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    assert SpaceFolder(tables, "small").current().name == before
    SpaceFolder(tables, "small").current().verify()
    assert build(tables=tables, labels=labels, scorer=HashScorer("hash@2")).published


def damage_truncate(path):
    path.write_bytes(path.read_bytes()[:-1])


def damage_flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def damage_empty(path):
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [damage_truncate, damage_flip, damage_empty, Path.unlink])
def test_a_damaged_table_is_named_and_the_next_build_makes_it_again(tables, labels, damage):
    for name in ("query_scores.parquet", "lookup/lookup.json"):
        version = SpaceFolder(tables, "small").current()
        damage(version.path / name)
        with pytest.raises(StoreError, match=rf"{Path(name).name} is damaged.*`roomtables build`"):
            version.verify()
        report = build(tables=tables, labels=labels, scorer=HashScorer())
        assert (report.published, report.sentences_scored) == (True, 0)
        SpaceFolder(tables, "small").current().verify()


@pytest.mark.parametrize("damage", [damage_truncate, damage_flip, damage_empty])
def test_a_damaged_part_is_named_and_scored_again_once_removed(tables, labels, damage):
    part = sorted(SentenceCache(tables, "hash@1").folder.glob("part-*"))[0]
    damage(part)
    with pytest.raises(StoreError, match=rf"{part.name} is damaged.*remove it and run") as error:
        build(tables=tables, labels=labels, scorer=HashScorer())
    assert "\n" not in str(error.value)
    part.unlink()
    report = build(tables=tables, labels=labels, scorer=HashScorer())
    assert report.sentences_scored in (16, 30)  # what the one part held, or the other


def published(tables):
    return SpaceFolder(tables, "small").current()


def held(tables):
    return SentenceCache(tables, "hash@1").select()


LINKED = {
    "small": published,
    "small/CURRENT": published,
    "small/0*": published,
    "small/0*/lookup": published,
    "scores/hash@1": held,
    "scores/hash@1/part-*": held,
}


@pytest.mark.parametrize("which", LINKED)
def test_links_out_of_the_folder_are_refused(tables, tmp_path, labels, which):
    path = max(tables.glob(which))
    moved = tmp_path / f"moved-{path.name}"
    path.rename(moved)
    path.symlink_to(moved)
    before = sorted((found, found.stat().st_mtime_ns) for found in moved.rglob("*"))
    with pytest.raises(RoomtablesError, match="is a symbolic link out of"):
        LINKED[which](tables)
    # A build refuses it or makes a version of its own; what the link names is not touched.
    with suppress(RoomtablesError):
        for k in (1, 2, 3):
            build(tables=tables, labels=labels, scorer=HashScorer(), k=k)
    assert sorted((found, found.stat().st_mtime_ns) for found in moved.rglob("*")) == before


def test_a_link_to_the_tables_folder_itself_is_fine(tmp_path, labels):
    (tmp_path / "disk").mkdir()
    (tmp_path / "t").symlink_to(tmp_path / "disk")
    build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    assert SpaceFolder(tmp_path / "t", "small").current().manifest.labels == "small"


def test_names_that_are_not_text(tmp_path, labels):
    tables = tmp_path / os.fsdecode(b"caf\xe9")
    with pytest.raises(StoreError, match="is not a UTF-8 name"):
        build(tables=tables, labels=labels, scorer=HashScorer())
    build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    stray = tmp_path / "t" / os.fsdecode(b"small-\xff")
    stray.mkdir()
    report = build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    assert not report.published


def test_the_lock_is_free_again_after_a_failure(tmp_path):
    with pytest.raises(ZeroDivisionError), build_lock(tmp_path):
        1 / 0  # noqa: B018
    with build_lock(tmp_path):
        assert (tmp_path / ".build-lock").read_text().startswith(f"process {os.getpid()} on ")
