"""Old versions, score parts, the version before, what changed: keeping a tables folder in order."""

import json
import os
import shutil
from datetime import UTC, datetime, timedelta

import duckdb
import pytest

from roomtables import build
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.offline.diff import compare
from roomtables.offline.upkeep import collect_garbage, compact, roll_back
from roomtables.scorer import SentenceScore
from roomtables.storage.files import held
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

SPACE = small_space()


@pytest.fixture
def labels(tmp_path):
    return str(write_space(tmp_path / "labels", SPACE))


@pytest.fixture
def tables(tmp_path):
    return tmp_path / "tables"


def make(tables, labels, *sizes, name="hash@1"):
    for k in sizes:
        build(tables=tables, labels=labels, scorer=HashScorer(name), k=k)
    return SpaceFolder(tables, "small")


def rows_of(cache):
    return sorted(duckdb.sql(cache.select()).fetchall())


def test_gc_keeps_the_newest_and_the_published(tables, labels):
    space = make(tables, labels, 1, 2)
    one, two = (path.name for path in space.versions())
    roll_back(tables, "small")
    assert [row.path for row in collect_garbage(tables, keep=1)] == []
    assert [path.name for path in space.versions()] == [one, two]
    make(tables, labels, 3)
    removed = collect_garbage(tables, keep=1)
    assert [(row.path, row.what) for row in removed] == [(f"small/{two}", "old version")]
    assert removed[0].bytes > 0
    assert space.current().path == space.versions()[-1]


def test_gc_keeps_what_a_reader_holds(tables, labels):
    space = make(tables, labels, 1)
    old = space.current()
    with held(old.path):
        make(tables, labels, 2, 3)  # each build keeps two versions, and this one
        assert len(space.versions()) == 3
        assert collect_garbage(tables) == []
        assert old.path.is_dir()
    assert [row.path for row in collect_garbage(tables)] == [f"small/{old.name}"]


def test_gc_removes_what_killed_builds_left(tables, labels):
    space = make(tables, labels, 1)
    (space.path / ".staging-1").mkdir()
    (space.path / ".removing-000009-0123abcd").mkdir()
    for aside in (".CURRENT.77.tmp", ".CURRENT.0123abcd.tmp"):
        (space.path / aside).write_text("half")
    (tables / "scores" / "hash@1" / ".77.tmp").write_bytes(b"x")
    run = SentenceCache(tables, "hash@1").run_folder()
    run.append(["a finished piece"], [SentenceScore(-1.0, 3)])
    (run.folder / "shard-000001.parquet").write_bytes(b"half")
    removed = {row.path for row in collect_garbage(tables)}
    half = {".staging-1", ".removing-000009-0123abcd", ".CURRENT.77.tmp", ".CURRENT.0123abcd.tmp"}
    assert {f"small/{name}" for name in half} <= removed
    assert {path.name for path in space.path.iterdir()} == {"CURRENT", space.current().name}
    left = [path.name for path in (tables / "scores" / "hash@1").iterdir()]
    assert all(name.startswith("part-") for name in left)
    assert "a finished piece" in {row[1] for row in rows_of(SentenceCache(tables, "hash@1"))}


def edit(version, **changes):
    path = version / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def damage_pointer(space, text):
    (space.path / "CURRENT").write_text(text)


@pytest.mark.parametrize(
    "damage",
    [
        lambda space: edit(space.current().path, schema_version=1),
        lambda space: (space.current().path / "manifest.json").write_text("{"),
        lambda space: (space.current().path / "manifest.json").unlink(),
        lambda space: damage_pointer(space, f"{space.current().name} 0000"),
        lambda space: damage_pointer(space, space.current().name[:9]),
        lambda space: (space.path / "CURRENT").write_bytes(b"\xff\xfe"),
        lambda space: damage_pointer(space, ""),
        lambda space: (space.path / "CURRENT").unlink(),
    ],
)
def test_gc_never_removes_what_current_names_even_if_it_cannot_be_opened(tables, labels, damage):
    space = make(tables, labels, 1, 2)
    roll_back(tables, "small")
    published = space.current().path
    with held(published, space.versions()[1]):
        make(tables, labels, 3)
    space.point_at(published)
    damage(space)
    collect_garbage(tables, keep=1)
    assert published.is_dir()
    assert len(list(published.glob("*.parquet"))) == 7


def test_gc_keeps_what_current_names_by_a_link(tables, labels):
    space = make(tables, labels, 1, 2)
    old = space.versions()[0]
    (space.path / "live").symlink_to(old.name)
    damage_pointer(space, "live")
    assert collect_garbage(tables, keep=1) == []
    assert old.is_dir()


def test_gc_keeps_what_no_build_wrote(tables, labels, caplog):
    space = make(tables, labels, 1, 2)
    one, two = space.versions()
    for name in ("2024-backup", "000000-0123abcd", "000000-notes", "000000-damaged"):
        shutil.copytree(one, space.path / name)
    (space.path / "000000-empty").mkdir()
    (space.path / "000000-0123abcd" / "mine.txt").write_text("x")
    (space.path / "000000-notes" / "manifest.json").write_text('["mine"]')
    (space.path / "000000-damaged" / "manifest.json").write_text("{")
    (space.path / "000000-linked").symlink_to(two)
    for name in (".staging-mine", ".staging-1b", ".removing-notes"):
        (space.path / name).mkdir()
        (space.path / name / "mine.txt").write_text("x")
    kept = {path.name for path in space.path.iterdir()} - {one.name}
    assert [row.path for row in collect_garbage(tables, keep=1)] == [f"small/{one.name}"]
    assert {path.name for path in space.path.iterdir()} == kept
    assert "000000-0123abcd stays: no build wrote its mine.txt" in caplog.text
    assert "000000-damaged stays: no build wrote its manifest.json" in caplog.text


def test_gc_removes_nothing_through_a_link(tables, labels, tmp_path):
    space = make(tables, labels, 1)
    with held(space.current().path):
        make(tables, labels, 2, 3)
    (space.path / ".staging-1").mkdir()
    moved = space.path.rename(tmp_path / "elsewhere")
    space.path.symlink_to(moved)
    before = sorted(moved.rglob("*"))
    assert collect_garbage(tables, keep=1) == []
    assert sorted(moved.rglob("*")) == before


def test_gc_of_a_space_whose_first_build_was_killed(tables, labels):
    (tables / "small" / ".staging-1").mkdir(parents=True)
    (tables / "theirs").mkdir()
    (tables / "theirs" / ".x.1.tmp").write_text("x")
    assert [row.path for row in collect_garbage(tables)] == ["small/.staging-1"]
    assert (tables / "theirs" / ".x.1.tmp").exists()


def test_gc_of_unused_scores(tables, labels):
    make(tables, labels, 1, name="hash@1")
    make(tables, labels, 1, 2, name="hash@2")
    assert (tables / "scores" / "hash@1").is_dir()
    removed = collect_garbage(tables, keep=1, unused_scores=True)
    assert [row.path for row in removed if row.what.startswith("scores")] == ["scores/hash@1"]
    assert build(tables=tables, labels=labels, scorer=HashScorer("hash@2"), k=2).published is False


def test_compact_merges_and_nothing_changes(tables, labels):
    make(tables, labels, 1, 2, 3)
    cache = SentenceCache(tables, "hash@1")
    before = rows_of(cache)
    (done,) = compact(tables)
    assert (done.scorer_id, done.parts_before, done.parts_after) == ("hash@1", 3, 1)
    assert rows_of(cache) == before
    assert len(list(cache.folder.glob("part-*"))) == 1
    assert compact(tables)[0].parts_after == 1
    scorer = HashScorer()
    report = build(tables=tables, labels=labels, scorer=scorer, k=3)
    assert (scorer.asked, report.published) == ([], False)


def test_compact_leaves_readers_their_files(tables, labels):
    make(tables, labels, 1, 2)
    cache = SentenceCache(tables, "hash@1")
    select, before = cache.select(), rows_of(cache)
    with held(cache.folder):
        compact(tables)
        assert sorted(duckdb.sql(select).fetchall()) == before  # the reader's own, retired
        assert rows_of(cache) == before
        assert len(list(cache.folder.glob("part-*"))) == 3
    removed = collect_garbage(tables)
    assert [row.what for row in removed] == ["retired", "retired"]
    assert rows_of(cache) == before


def test_compact_removes_doubles(tables):
    cache = SentenceCache(tables, "m@1")
    cache.append(["a", "b"], [SentenceScore(-1.0, 1), SentenceScore(-2.0, 1)])
    cache.append(["b", "c"], [SentenceScore(-2.0, 1), SentenceScore(-3.0, 1)])
    compact(tables)
    assert [row[1:3] for row in rows_of(cache)] == [("a", -1.0), ("b", -2.0), ("c", -3.0)]


def test_a_part_written_after_a_refresh_is_not_one_that_it_retired(tables):
    cache = SentenceCache(tables, "m@1")
    connection = duckdb.connect()
    connection.execute("create table needed as select 'a' as sentence")
    with held(cache.folder):  # so that the retired part stays
        for _ in range(3):
            cache.append(["a"], [SentenceScore(-1.0, 1)])
            assert len(rows_of(cache)) == 1
            cache.evict(connection, "needed")
            assert rows_of(cache) == []


def test_a_repeated_piece_of_work_counts_once(tables):
    cache = SentenceCache(tables, "m@1")
    cache.append(["a", "b"], [SentenceScore(-1.0, 1), SentenceScore(-2.0, 1)])
    cache.append(["a", "b"], [SentenceScore(-1.0000001, 1), SentenceScore(-2.0, 1)])
    assert [row[1] for row in rows_of(cache)] == ["a", "b"]


def test_rollback_and_the_next_build(tables, labels):
    space = make(tables, labels, 1, 2)
    one, two = (path.name for path in space.versions())
    left, now = roll_back(tables, "small")
    assert (left.name, now.name, space.current().name) == (two, one, one)
    with pytest.raises(StoreError, match="nothing came before"):
        roll_back(tables, "small")
    report = build(tables=tables, labels=labels, scorer=HashScorer(), k=2)
    assert report.published
    assert report.sentences_scored == 0
    assert report.version.startswith("000003-")


def test_rollback_to_a_damaged_version_is_refused(tables, labels):
    space = make(tables, labels, 1, 2)
    current = space.current().name
    (space.versions()[0] / "entropy.parquet").write_bytes(b"x")
    with pytest.raises(StoreError, match=r"entropy.parquet is damaged"):
        roll_back(tables, "small")
    assert space.current().name == current


def test_diff_names_what_moved(tables, labels, tmp_path):
    space = make(tables, labels, 2)
    objects = (*SPACE.objects[1:], *LabelSpace.named("x", ["lamp"], ["x"]).objects)
    write_space(tmp_path / "labels", LabelSpace("small", objects, SPACE.rooms))
    make(tables, labels, 2)
    same = compare(space.current(), space.current())
    assert (same.objects, same.settings) == ([], {})
    found = compare(space.before(space.current()), space.current())
    moved = {row["object"]: row for row in found.objects}
    assert set(moved) == {"bed", "lamp"}
    assert moved["bed"]["entropy_after"] is None
    assert moved["lamp"]["entropy_before"] is None
    # pairs of the three that stayed, and they themselves
    assert found.combinations == [
        {"source": "proxy", "held_in_both": 6, "added": 4, "removed": 4, "other_room": 0}
    ]


def test_diff_of_two_models_puts_other_rooms_first(tables, labels):
    space = make(tables, labels, 1)
    make(tables, labels, 1, name="hash@2")
    found = compare(space.before(space.current()), space.current())
    assert found.settings["scorer_id"] == ("hash@1", "hash@2")
    other = [row["first_room_before"] != row["first_room_after"] for row in found.objects]
    assert other == sorted(other, reverse=True)
    for group in (True, False):
        changes = [
            abs(row["entropy_change"])
            for row, moved in zip(found.objects, other, strict=True)
            if moved is group
        ]
        assert changes == sorted(changes, reverse=True)


def last_two(space):
    return compare(space.before(space.current()), space.current())


def test_diff_of_a_room_with_another_label(tables, labels, tmp_path):
    """Labels sort otherwise then; no answer is another, but for the label."""
    space = make(tables, labels, 2)
    write_rooms(tmp_path, ["yonder", "bedroom", "kitchen"], like="bathroom")
    build(tables=tables, labels=labels, scorer=Renamed("yonder", "bathroom"), k=2)
    found = last_two(space)
    assert found.causes == ("room bathroom renamed to yonder",)
    assert [(row["held_in_both"], row["other_room"]) for row in found.combinations] == [(10, 0)]
    assert found.objects == []
    assert found.nothing_moved


class Renamed(HashScorer):
    """Scores a room under another label as it was under its own."""

    def __init__(self, new, old):
        super().__init__()
        self._names = (new, old)

    def score_of(self, sentence):
        return HashScorer().score_of(sentence.replace(*self._names))


def write_rooms(folder, rooms, like):
    space = LabelSpace.named("small", ["bed"], rooms)
    others = [room for room in SPACE.rooms if room.label not in {like, "bedroom", "kitchen"}]
    write_space(folder / "labels", LabelSpace("small", SPACE.objects, (*space.rooms, *others)))


class Noisy(HashScorer):
    """The same scores, but for sums in another order."""

    def score_of(self, sentence):
        found = super().score_of(sentence)
        return SentenceScore(found.log_prob * (1 + 1e-14), found.token_count)


def test_diff_of_sums_in_another_order_is_short(tables, labels):
    space = make(tables, labels, 2)
    build(tables=tables, labels=labels, scorer=Noisy(), k=2, full_refresh=True)
    found = last_two(space)
    assert (found.objects, found.groups, found.causes) == ([], [], ())
    assert found.nothing_moved


def test_a_tie_within_the_tolerance_is_no_other_room(tables, tmp_path):
    space = LabelSpace.named("small", ["bed", "sink"], ["bathroom", "bedroom"])
    labels = str(write_space(tmp_path / "labels", space))
    for counted in (9, 9 + 1e-12):
        counts = tmp_path / "counts.csv"
        counts.write_text(f"object,room,count\nbed,bathroom,9\nbed,bedroom,{counted!r}\n")
        build(tables=tables, labels=labels, scorer=HashScorer(), k=1, counts=counts)
    found = last_two(SpaceFolder(tables, "small"))
    assert found.causes == ("counts.csv changed",)
    assert found.nothing_moved


def test_diff_groups_what_moved_by_cause(tables, labels, tmp_path):
    space = make(tables, labels, 1)
    counts = tmp_path / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,9\n")
    build(tables=tables, labels=labels, scorer=HashScorer(), k=1, counts=counts)
    found = last_two(space)
    assert [(g["source"], g["cause"], g["objects"]) for g in found.groups] == [
        ("ground_truth", "counts.csv added", 4)
    ]
    counts.write_text("object,room,count\nbed,kitchen,9\n")
    build(tables=tables, labels=labels, scorer=HashScorer(), k=1, counts=counts, reduction="mean")
    found = last_two(space)
    groups = {group["source"]: group for group in found.groups}
    assert groups["ground_truth"]["cause"] == "counts.csv changed"
    assert (groups["ground_truth"]["objects"], groups["ground_truth"]["other_first_room"]) == (1, 1)
    assert groups["proxy"]["cause"] == "reduction sum → mean"
    assert groups["proxy"]["objects"] == 4
    largest = max(abs(r["entropy_change"]) for r in found.objects if r["source"] == "proxy")
    assert groups["proxy"]["largest_entropy_change"] == largest


@pytest.mark.parametrize("action", [collect_garbage, compact, lambda t: roll_back(t, "small")])
def test_no_folder_is_made_for_upkeep(tables, action):
    with pytest.raises(StoreError, match=r"no tables in .*roomtables build"):
        action(tables)
    assert not tables.exists()


def test_a_clock_that_goes_backwards(tables, labels, monkeypatch):
    space = make(tables, labels, 1)
    past = (datetime.now(UTC) - timedelta(days=400)).replace(microsecond=0)
    monkeypatch.setattr("roomtables.offline.builder.utc_now", lambda: past)
    make(tables, labels, 2)
    assert space.current().manifest.created == past
    assert space.current().name.startswith("000002-")
    old = datetime.now().timestamp() - 10**8
    for path in tables.rglob("*"):
        os.utime(path, (old, old))
    assert collect_garbage(tables) == []
    assert roll_back(tables, "small")[1].name.startswith("000001-")
