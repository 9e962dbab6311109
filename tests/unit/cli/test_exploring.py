"""`roomtables sql`: one query, DuckDB's own shell, a database, harlequin."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from click.testing import CliRunner

from roomtables.cli import exploring, main
from roomtables.storage.versions import SpaceFolder
from sql_fixtures import save_evaluation
from tiny_tables import OBJECTS, ROOMS, build_tables

needs_shell = pytest.mark.skipif(not find_spec("duckdb_cli"), reason="no duckdb-cli installed")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build_tables(tmp_path_factory.mktemp("explored"))


def run(folder, *arguments):
    return CliRunner().invoke(main, ["sql", "--tables", str(folder), *arguments])


def shell(folder, typed, *arguments, cwd=None, env=None):
    command = [sys.executable, "-m", "roomtables", "sql", "--tables", str(folder), *arguments]
    return subprocess.run(
        command, input=typed, capture_output=True, text=True, cwd=cwd, env=env, check=False
    )


def test_a_query_in_every_format(folder):
    query = "select 1 as a, ['x', 'y'] as b"
    assert run(folder, query, "--format", "csv").stdout == 'a,b\n1,"x, y"\n'
    assert json.loads(run(folder, query, "--format", "json").stdout) == [{"a": 1, "b": ["x", "y"]}]
    assert run(folder, "select now() as now", "--format", "jsonl").exit_code == 0


def test_a_wrong_or_writing_query_is_one_line(folder):
    for query in ("select nonsense", "with x as (delete from noted_misses returning *) from x"):
        found = run(folder, query)
        assert found.exit_code == 1
        assert found.stderr.startswith("error: SQL")
        assert found.stderr.count("\n") == 1


def test_room_lists_can_be_joined_and_nothing_else_read(folder, tmp_path):
    joined = tmp_path / "it's [1].jsonl"
    joined.write_text('{"room_id": "a", "room": "kitchen", "objects": ["oven", "stove"]}\n')
    other = tmp_path / "other.jsonl"
    other.write_text(joined.read_text())
    query = (
        "select room_id, names.object from rooms, unnest(objects) as given(name) "
        "join names using (name) order by 2"
    )
    found = run(folder, "--with", f"rooms={joined}", query, "--format", "csv")
    assert found.stdout == "room_id,object\na,oven\na,oven\n"
    # Views still read the table that the file's name is that of.
    query = "select count(distinct room) from evidence"
    assert run(folder, "--with", f"rooms={joined}", query, "--format", "csv").stdout.endswith(
        f"\n{len(ROOMS)}\n"
    )
    for path in (other, "/etc/hostname"):
        query = f"select count(*) from read_text('{path}')"
        assert run(folder, "--with", f"rooms={joined}", query).exit_code == 1
    table = tmp_path / "counts.csv"
    table.write_text("object,n\nbed,3\n")
    found = run(folder, "--with", f"counts={table}", "from counts", "--format", "csv")
    assert found.stdout == "object,n\nbed,3\n"


def test_a_broken_joined_file_is_one_line(folder, tmp_path):
    broken = tmp_path / "broken.jsonl"
    broken.write_text('{"a": 1}\n' * 3 + "{not json\n")
    found = run(folder, "--with", f"log={broken}", "select count(*) from log where a > 0")
    assert found.exit_code == 1
    assert str(broken) in found.stderr
    assert found.stderr.count("\n") == 1
    assert run(folder, "--with", "log=nothere.csv", "from log").exit_code == 1


def test_a_damaged_table_or_part_is_one_line(tmp_path):
    folder = build_tables(tmp_path)
    part, *_ = (folder / "scores").glob("*/part-*.parquet")
    content = bytearray(part.read_bytes())
    content[100] ^= 1
    part.write_bytes(content)
    assert run(folder, "select 1").exit_code == 0
    for arguments in (["select count(*) from SENTENCE_SCORES"], ["--verify", "select 1"]):
        found = run(folder, *arguments)
        assert found.exit_code == 1
        assert f"{part} is damaged" in found.stderr
    table = SpaceFolder(folder, "flat").current().path / "entropy.parquet"
    table.write_bytes(table.read_bytes()[:-1])
    found = run(folder, "select 1")
    assert found.exit_code == 1
    assert found.stderr.count("\n") == 1
    assert f"{table} is damaged; run `roomtables build`" in found.stderr


@needs_shell
def test_without_a_query_duckdbs_own_shell(folder, tmp_path):
    version = SpaceFolder(folder, "flat").current()
    save_evaluation(version, "monday", [("1", "kitchen", "office")])
    log = tmp_path / "log.csv"
    log.write_text("label\nelsewhere\n")
    typed = (
        "select count(*) as n from entropy;\nfrom confusion;\nfrom rooms;\n"
        "select unknown_objects[1] from p_room_given(['toilte']);\n"
    )
    found = shell(
        folder.relative_to(folder.parent), typed, "--with", f"rooms={log}", "--format", "csv",
        cwd=folder.parent,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    lines = found.stdout.split()
    assert str(len(OBJECTS)) in lines
    assert "monday,proxy,query,kitchen,office,1" in lines
    assert "elsewhere" in lines
    assert "toilte" in lines


@needs_shell
@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("select count(*) from read_text('/etc/hostname');", "disabled by configuration"),
        ("copy (select 1) to '{tmp}/out.csv';", "disabled by configuration"),
        ("attach '{tmp}/new.duckdb' as new;", ""),
        ("set threads = 1;", "locked"),
        ("set enable_external_access = true;", ""),
        ("create table mine as select 1;", "read-only"),
        (".shell echo hi", "safe mode"),
        (".read /etc/hostname", "safe mode"),
        ("select nonsense;", "^"),
    ],
)
def test_the_shell_reads_the_tables_and_nothing_else(folder, tmp_path, typed, said):
    found = shell(folder, typed.format(tmp=tmp_path) + "\n")
    assert found.returncode == 1
    assert said in found.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [[], ["--ui"]])
def test_without_the_extra_it_says_what_to_install(folder, tmp_path, monkeypatch, arguments):
    monkeypatch.setattr(exploring, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", str(tmp_path))
    found = run(folder, *arguments)
    assert found.exit_code == 1
    assert "pip install 'roomtables[ui]'" in found.stderr


def test_a_database_is_written_and_noted(tmp_path):
    folder = build_tables(tmp_path)
    database = tmp_path / "rooms.duckdb"
    found = run(folder, "--db", str(database))
    assert found.exit_code == 0, found.stderr
    assert str(database) in found.stdout
    assert database.is_file()
    (note,) = (folder / "flat" / "databases").iterdir()
    noted = {"database": str(database), "with": {}, "tables": str(folder / "flat")}
    assert json.loads(note.read_text()) == noted
    (tmp_path / "mine.txt").write_text("x")
    found = run(folder, "--db", str(tmp_path / "mine.txt"))
    assert found.exit_code == 1
    assert "give another name" in found.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["--ui", "select 1"],
        ["--ui", "-o", "x"],
        ["--db", "x.duckdb", "select 1"],
        ["--db", "x.duckdb", "--ui"],
        ["-o", "x"],
    ],
)
def test_options_that_do_not_go_together(folder, arguments):
    assert run(folder, *arguments).exit_code == 2
    assert not Path("x.duckdb").exists()


def test_ui_hands_over_a_database_with_every_view(folder, tmp_path):
    """What harlequin is started on can be read by another process, read-only."""
    (tmp_path / "harlequin").mkdir()
    (tmp_path / "harlequin" / "__init__.py").touch()
    (tmp_path / "harlequin" / "__main__.py").write_text(
        "import duckdb, sys\n"
        "assert '--read-only' in sys.argv\n"
        "c = duckdb.connect(sys.argv[-1], read_only=True)\n"
        "print(c.execute('select count(*) from entropy').fetchone()[0],\n"
        "      len(c.execute(\"from p_room_given(['bed'])\").fetchall()))\n"
    )
    path = os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(tmp_path)])
    found = shell(folder, "", "--ui", env=os.environ | {"PYTHONPATH": path})
    assert found.stdout.split() == [str(len(OBJECTS)), str(len(ROOMS))]
