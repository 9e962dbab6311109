"""Databases for other programs: what they hold, that builds write them anew, what they spare."""

import json
import logging
import multiprocessing
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import duckdb
import pytest

from roomtables import RoomTables, build
from roomtables.errors import InputError, StoreError
from roomtables.offline.upkeep import collect_garbage, compact, roll_back
from roomtables.storage.client_databases import ClientDatabase, write_anew
from roomtables.storage.joined import JoinedFile, parse_joined
from roomtables.storage.versions import SpaceFolder
from sql_fixtures import save_evaluation
from tiny_tables import ROOMS, FitScorer, build_tables, change_tables

# In a process of its own, from another working directory, as any client opens it.
_READ = (
    "import duckdb, json, sys; c = duckdb.connect(sys.argv[1], read_only=True); "
    "print(json.dumps([c.execute(q).fetchall() for q in sys.argv[2:]], default=str))"
)


def read(database, *queries):
    command = [sys.executable, "-c", _READ, str(database), *queries]
    return json.loads(subprocess.check_output(command, cwd="/", text=True))


def shell(database, *queries):
    """The same with the shell of DuckDB 1.x."""
    program = Path(find_spec("duckdb_cli").origin).with_name("duckdb")
    answers = []
    for query in queries:
        command = [program, "-readonly", "-json", str(database), "-c", query]
        text = subprocess.check_output(command, cwd="/", text=True)
        answers.append([list(row.values()) for row in json.loads(text or "[]")])
    return answers


CLIENTS = [
    pytest.param(read, id="duckdb"),
    pytest.param(
        shell,
        id="duckdb-cli",
        marks=pytest.mark.skipif(not find_spec("duckdb_cli"), reason="no duckdb-cli installed"),
    ),
]


@pytest.fixture
def folder(tmp_path):
    """Two versions, in a folder with an odd name that is given as a relative path."""
    odd = tmp_path / "it's [a] *folder* {x}"
    odd.mkdir()
    build_tables(odd)
    change_tables(odd)
    return odd


@pytest.fixture
def tables(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return Path("tables")


def current(tables):
    return SpaceFolder(tables, "flat").current()


@pytest.mark.parametrize("client", CLIENTS)
def test_any_client_reads_every_view_and_macro_from_anywhere(tables, client):
    version = current(tables)
    save_evaluation(version, "monday", [("1", "kitchen", "office")])
    Path("log.jsonl").write_text('{"room_id": "7", "objects": ["bed"]}\n')
    database = ClientDatabase.at(Path("rooms.duckdb"), parse_joined(["log=log.jsonl"]))
    database.write(tables, version)
    (names,) = client(database.path, "select name from guide")
    views = [name for (name,) in names if "(" not in name]
    assert {"entropy", "versions", "version_changes", "confusion", "miss_coverage", "log"} <= {
        *views
    }
    counts = client(database.path, *(f"select count(*) as n from {view}" for view in views))
    rows = dict(zip(views, (n for ((n,),) in counts), strict=True))
    assert rows["versions"] == 2
    assert rows["confusion"] == rows["log"] == 1
    assert min(rows[view] for view in views if view not in {"misses", "miss_coverage"}) > 0
    opened = RoomTables.open(tables, "flat", offline=True, note_misses=False)
    expected = opened.classify(["bed", "stove"])
    calls = [
        "select room, p_room from decided(['BEDS', 'stove', 'toilte'])",
        "select unknown_objects from p_room_given(['toilte'])",
        "select nearest from read_names(['lmap'])",
        "select prior_weight, rule from decision",
        "select objects from log",
    ]
    found, unknown, nearest, decision, joined = client(database.path, *calls)
    assert dict(map(tuple, found)) == pytest.approx(expected.probabilities, abs=1e-9)
    # The shell prints lists in its own way, or as JSON.
    assert "toilte" in str(unknown)
    assert nearest == [["lamp"]]
    assert decision == [[0.25, "query"]]
    assert "bed" in str(joined)


def test_builds_write_it_anew(tables, folder):
    database = ClientDatabase.at(Path("rooms.duckdb"))
    database.write(tables, current(tables))
    database.note(SpaceFolder(tables, "flat"))
    labels = str(folder / "flat")
    for weight in (0.75, 0.5, 0.5):  # the last build has nothing to do
        build(tables=tables, labels=labels, scorer=FitScorer(), combinations="all",
              prior_weight=weight)  # fmt: skip
        ((found,),) = read(database.path, "select prior_weight from decision")
        assert found == [weight]
        # Old versions are gone, and no view reads them.
        read(database.path, "from version_changes", "from sentence_scores")
    compact(tables)
    collect_garbage(tables, keep=1)
    assert read(database.path, "select count(*) from version_changes", "from sentence_scores")
    build(tables=tables, labels=labels, scorer=FitScorer(), combinations="all", prior_weight=0)
    roll_back(tables, "flat")
    assert read(database.path, "select prior_weight from decision") == [[[0.5]]]


def test_what_cannot_be_written_anew_is_one_warning(tables, folder, caplog, monkeypatch):
    space = SpaceFolder(tables, "flat")
    for name in ("kept", "mine", "gone"):
        database = ClientDatabase.at(folder / name / "rooms.duckdb")
        database.path.parent.mkdir()
        database.write(tables, current(tables))
        database.note(space)
    mine = folder / "mine" / "rooms.duckdb"
    mine.write_bytes(b"my own")
    (folder / "gone" / "rooms.duckdb").unlink()
    (tables / "flat" / "databases" / "0123456789abcdef.json").write_text("[]")
    with caplog.at_level(logging.WARNING):
        build(tables=tables, labels=str(folder / "flat"), scorer=FitScorer(), combinations="all",
              prior_weight=0.9)  # fmt: skip
    assert current(tables).manifest.settings.prior_weight == 0.9
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 3
    assert any(str(mine) in line and "not written anew" in line for line in said)
    assert any("is gone" in line for line in said)
    assert mine.read_bytes() == b"my own"
    assert read(folder / "kept" / "rooms.duckdb", "select prior_weight from decision") == [[[0.9]]]
    caplog.clear()
    write_anew(tables)
    assert "is gone" not in caplog.text


def test_a_copy_of_the_tables_leaves_the_database_alone(tables, folder, caplog):
    database = ClientDatabase.at(Path("rooms.duckdb"))
    database.write(tables, current(tables))
    database.note(SpaceFolder(tables, "flat"))
    before = database.path.read_bytes()
    shutil.copytree(tables, "copied")
    with caplog.at_level(logging.WARNING):
        write_anew(Path("copied"))
        write_anew(Path("copied"))
    assert caplog.text.count("is not written anew") == 1
    assert database.path.read_bytes() == before


def test_a_joined_file_that_went_is_one_warning(tables, folder, caplog):
    Path("log.csv").write_text("a\n1\n")
    database = ClientDatabase.at(Path("rooms.duckdb"), parse_joined(["log=log.csv"]))
    database.write(tables, current(tables))
    database.note(SpaceFolder(tables, "flat"))
    Path("log.csv").unlink()
    before = database.path.read_bytes()
    with caplog.at_level(logging.WARNING):
        write_anew(tables)
    assert "log.csv" in caplog.text
    assert database.path.read_bytes() == before


def test_nothing_of_somebody_else_is_overwritten(tables):
    text = ClientDatabase.at(Path("notes.txt"))
    text.path.write_text("my notes")
    with pytest.raises(InputError, match=r"notes\.txt is no database that"):
        text.write(tables, current(tables))
    assert text.path.read_text() == "my notes"
    with duckdb.connect("own.duckdb") as own:
        own.execute("create table decision as select 1 as a")
    with pytest.raises(InputError, match="tables of your own"):
        ClientDatabase.at(Path("own.duckdb")).write(tables, current(tables))
    with duckdb.connect("views.duckdb") as own:
        own.execute("create view a as select 1 as a")
    with pytest.raises(InputError, match="is no database that"):
        ClientDatabase.at(Path("views.duckdb")).write(tables, current(tables))
    ours = ClientDatabase.at(Path("rooms.duckdb"))
    ours.write(tables, current(tables))
    Path("rooms.duckdb.wal").write_bytes(b"changes")
    with pytest.raises(StoreError, match=r"\.wal holds changes"):
        ours.write(tables, current(tables))


def _open_for_writing(path, opened, done):
    with duckdb.connect(path):
        opened.set()
        done.wait(60)


def test_one_that_is_open_for_writing_is_refused_and_for_reading_replaced(tables):
    database = ClientDatabase.at(Path("rooms.duckdb"))
    database.write(tables, current(tables))
    with duckdb.connect(str(database.path), read_only=True) as reader:
        database.write(tables, current(tables))
        assert reader.execute("select count(*) from rooms").fetchone() == (len(ROOMS),)
    context = multiprocessing.get_context("spawn")
    opened, done = context.Event(), context.Event()
    process = context.Process(target=_open_for_writing, args=(str(database.path), opened, done))
    process.start()
    try:
        assert opened.wait(60)
        with pytest.raises(StoreError, match="open in another program"):
            database.write(tables, current(tables))
    finally:
        done.set()
        process.join()


def test_a_read_only_tables_folder_is_read_all_the_same(tables, folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    database = ClientDatabase.at(out / "rooms.duckdb")
    space = tables / "flat"
    if os.geteuid() == 0:
        # Root may write anywhere: a file where the folder of notes would be stands in its way.
        (space / "databases").write_text("")
    else:
        space.chmod(0o555)
    try:
        database.write(tables, current(tables))
        with pytest.raises(StoreError):
            database.note(SpaceFolder(tables, "flat"))
    finally:
        space.chmod(0o755)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log", "is not NAME=FILE"),
        ("=log.csv", "is not NAME=FILE"),
        ("1x=log.csv", "is not NAME=FILE"),
        ("a b=log.csv", "is not NAME=FILE"),
        ("log=nothere.csv", "there is no file"),
        ("log=log.txt", r"must be one of \*\.jsonl"),
    ],
)
def test_what_cannot_be_joined(tmp_path, monkeypatch, text, said):
    monkeypatch.chdir(tmp_path)
    for name in ("log.csv", "log.txt"):
        (tmp_path / name).write_text("a\n1\n")
    with pytest.raises(InputError, match=said):
        parse_joined([text])
    with pytest.raises(InputError, match="given twice"):
        parse_joined(["log=log.csv", "LOG=log.csv"])


def test_a_file_with_a_tables_name_leaves_the_views_as_they_are(tables):
    Path("rooms.csv").write_text("label\nnowhere\n")
    database = ClientDatabase.at(Path("rooms.duckdb"), parse_joined(["rooms=rooms.csv"]))
    database.write(tables, current(tables))
    joined, own, evidence = read(
        database.path,
        "from joined.rooms",
        "select count(*) from rooms",
        "select count(distinct room) from evidence",
    )
    assert joined == [["nowhere"]]
    assert own == evidence == [[len(ROOMS)]]
    taken = [JoinedFile("Names", Path("rooms.csv").resolve())]
    with pytest.raises(InputError, match="macros read"):
        ClientDatabase.at(Path("other.duckdb"), taken).write(tables, current(tables))
    Path("bad.parquet").write_bytes(b"not Parquet")
    with pytest.raises(InputError, match=r"cannot read .*bad\.parquet"):
        ClientDatabase.at(Path("other.duckdb"), parse_joined(["b=bad.parquet"])).write(
            tables, current(tables)
        )
