"""A tables folder whose path holds characters that DuckDB, SQL or a terminal reads otherwise."""

import pytest

from roomtables import RoomTables, build
from roomtables.errors import StoreError
from roomtables.offline.diff import compare
from roomtables.offline.plan import plan
from roomtables.offline.upkeep import compact
from roomtables.schemas import parquet
from roomtables.storage.export import export
from roomtables.storage.versions import SpaceFolder
from roomtables.storage.views import connect, select
from support import HashScorer, small_space, write_space

# A neighbour that the name, read as a pattern, would match too.
NAMES = {
    "a?b": "axb", "a*b": "axxb", "a[xy]b": "ayb", "a'b": "ab", "a\nb": "a b", " a b ": "a b",
    "é$(x)": "é", "a{b,c}": "ab", "**": "x", "%41;--": "A", "a]b[c": "abc",
}  # fmt: skip


@pytest.fixture(scope="module")
def labels(tmp_path_factory):
    return str(write_space(tmp_path_factory.mktemp("labels"), small_space()))


OFTEN = ("a[xy]b", "a'b", "a\nb")  # a pattern, SQL, a terminal


@pytest.mark.parametrize(
    "name", [n if n in OFTEN else pytest.param(n, marks=pytest.mark.slow) for n in NAMES]
)
def test_a_folder_of_any_name_holds_its_own_tables(tmp_path, labels, name):
    other = tmp_path / NAMES[name]
    build(tables=other, labels=labels, scorer=HashScorer("other@1"), k=2)
    tables = tmp_path / name
    for k in (1, 2):
        assert build(tables=tables, labels=labels, scorer=HashScorer(), k=k).published
    assert not build(tables=tables, labels=labels, scorer=HashScorer(), k=2).published
    assert plan(tables=tables, labels=labels, scorer=HashScorer(), k=2).sentences_to_score == 0
    space = SpaceFolder(tables, "small")
    newer = space.current()
    assert compare(space.before(newer), newer).combinations[0]["added"] == 6
    assert RoomTables.open(tables, "small", offline=True).classify(["bed", "sink"]).room
    with connect(tables, newer) as connection:
        scorers = select(connection, "select distinct scorer_id from sentence_scores")[1]
        count = select(connection, "select count(*) from query_scores")[1]
    assert (scorers, count) == ([("hash@1",)], [(10,)])
    (done,) = compact(tables)
    assert (done.parts_before, done.parts_after) == (2, 1)
    assert export(tables, "small", tmp_path / f"{name}.tar.zst")
    assert not build(tables=tables, labels=labels, scorer=HashScorer(), k=2).published


def test_a_backslash_which_duckdb_takes_for_a_slash_is_refused(tmp_path, labels):
    with pytest.raises(StoreError, match="backslash for a slash; use a folder without one"):
        build(tables=tmp_path / "a\\b", labels=labels, scorer=HashScorer())
    assert not (tmp_path / "a").exists()


def test_a_path_is_no_pattern():
    assert parquet("/a*b/x[1]?'.parquet") == "read_parquet(['/a[*]b/x[[]1][?]''.parquet'])"
    assert parquet("/a/x.parquet", "/b/y.parquet").count("parquet'") == 2
