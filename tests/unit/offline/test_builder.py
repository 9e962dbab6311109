"""The build against a plain numpy computation of DESIGN's definitions, and what it costs twice."""

import json
import math
from itertools import combinations

import duckdb
import numpy as np
import pyarrow.parquet as pq
import pytest

from roomtables import RoomTables, build
from roomtables.config import pipeline_folder
from roomtables.errors import InputError, LabelSpaceError, ModelError, StoreError
from roomtables.labels import LabelSpace
from roomtables.offline import builder
from roomtables.scorer import SentenceScore
from roomtables.sentences import Template
from roomtables.storage.lookup import Lookup, pack_keys
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

SPACE = small_space()


def table(tables, name, order, labels="small"):
    version = SpaceFolder(tables, labels).current()
    path = version.path / f"{name}.parquet"
    return duckdb.sql(f"select * from '{path}' order by {order}").fetchall()


def softmax(row):
    e = np.exp(row - np.max(row))
    return e / e.sum()


def single_scores(scorer, reduction="sum"):
    return np.array(
        [
            [scorer.score_of(s).reduced(reduction) for s in Template().compose([o], SPACE.rooms)]
            for o in SPACE.objects
        ]
    )


@pytest.mark.parametrize("reduction", ["sum", "mean"])
def test_tables_equal_a_naive_computation(tmp_path, labels, counts, reduction):
    scorer = HashScorer()
    build(tables=tmp_path, labels=labels, scorer=scorer, counts=counts, reduction=reduction)
    scores = single_scores(scorer, reduction)
    proxy = np.array([softmax(row) for row in scores])
    counted = np.full((4, 4), 1 / 4)
    counted[0, 1] += 9
    counted[1, 2] += 2
    counted[1, 0] += 3
    counted[2, 2] += 4
    ground_truth = counted / counted.sum(axis=1, keepdims=True)
    rows = table(tmp_path, "cooccurrence", "source, object, room")
    found = np.array([row[-1] for row in rows]).reshape(2, 4, 4)
    np.testing.assert_allclose(found, [ground_truth, proxy], rtol=0, atol=1e-12)

    for source, p in (("ground_truth", ground_truth), ("proxy", proxy)):
        entropy = -(p * np.log(p)).sum(axis=1)
        rows = [row for row in table(tmp_path, "entropy", "source, object") if row[0] == source]
        np.testing.assert_allclose([row[2] for row in rows], entropy, atol=1e-12)
        ranked = sorted(range(4), key=lambda o: (round(entropy[o], 10), SPACE.objects[o].label))
        assert [row[3] for row in rows] == [ranked.index(o) + 1 for o in range(4)]

    predicted = scores[:, :3]
    bias = np.mean([np.log(softmax(row)) for row in predicted], axis=0)
    for source in ("ground_truth", "proxy"):
        rows = [row[2] for row in table(tmp_path, "room_bias", "source, room") if row[0] == source]
        np.testing.assert_allclose(rows, bias, atol=1e-12)


def test_query_scores_hold_every_combination(tmp_path, labels, counts):
    scorer = HashScorer()
    build(tables=tmp_path, labels=labels, scorer=scorer, counts=counts)
    by_label = {o.label: o for o in SPACE.objects}
    for source in ("ground_truth", "proxy"):
        ranked = [r[1] for r in table(tmp_path, "entropy", "source, rank") if r[0] == source]
        rows = {
            tuple(objects): (key, scores)
            for found, key, objects, *scores in table(tmp_path, "query_scores", "key")
            if found == source
        }
        expected = [c for size in (1, 2, 3) for c in combinations(ranked, size)]
        assert set(rows) == set(expected)
        for objects in expected:
            ranks = [ranked.index(name) + 1 for name in objects] + [0] * (3 - len(objects))
            assert rows[objects][0] == pack_keys(np.array([ranks]), 3)[0]
            sentences = Template().compose([by_label[o] for o in objects], SPACE.predicted_rooms)
            scores = [scorer.score_of(s).log_prob for s in sentences]
            np.testing.assert_allclose(rows[objects][1], scores, rtol=1e-6)


def test_the_lookup_is_the_tables(tmp_path, labels, counts):
    build(tables=tmp_path, labels=labels, scorer=HashScorer(), counts=counts)
    version = SpaceFolder(tmp_path, "small").current()
    lookup = Lookup.open(version.path / "lookup", version.manifest)
    for source, arrays in lookup.sources.items():
        rows = [r for r in table(tmp_path, "query_scores", "source, key") if r[0] == source]
        assert arrays.keys.tolist() == [row[1] for row in rows]
        np.testing.assert_array_equal(arrays.scores, np.array([r[3:] for r in rows], np.float32))
        rows = [r for r in table(tmp_path, "entropy", "source, object") if r[0] == source]
        assert arrays.entropy.tolist() == [row[2] for row in rows]
        assert arrays.ranks.tolist() == [row[3] for row in rows]


def test_a_second_build_asks_nothing_and_publishes_nothing(tmp_path, labels):
    first = build(tables=tmp_path, labels=labels, scorer=HashScorer())
    scorer = HashScorer()
    second = build(tables=tmp_path, labels=labels, scorer=scorer)
    assert scorer.asked == []
    assert (second.version, second.published) == (first.version, False)
    assert second.sentences_cached == first.sentences_scored == 14 * 3 + 4


def test_every_sentence_is_asked_once(tmp_path, labels, counts):
    scorer = HashScorer()
    report = build(tables=tmp_path, labels=labels, scorer=scorer, counts=counts)
    assert len(scorer.asked) == len(set(scorer.asked)) == report.sentences_scored


def test_another_model_is_asked_everything(tmp_path, labels):
    first = build(tables=tmp_path, labels=labels, scorer=HashScorer())
    scorer = HashScorer("hash@2")
    second = build(tables=tmp_path, labels=labels, scorer=scorer)
    assert len(scorer.asked) == first.sentences_scored
    assert second.version != first.version


def test_another_label_space_asks_only_what_is_new(tmp_path, labels):
    build(tables=tmp_path, labels=labels, scorer=HashScorer())
    wider = LabelSpace("wider", (*SPACE.objects, *_objects("lamp")), SPACE.rooms)
    scorer = HashScorer()
    report = build(
        tables=tmp_path, labels=str(write_space(tmp_path / "labels", wider)), scorer=scorer
    )
    assert scorer.asked
    assert all("lamp" in sentence for sentence in scorer.asked)
    assert report.sentences_cached > 0


def _objects(*names):
    return LabelSpace.named("x", names, ["x"]).objects


def test_full_refresh_asks_again_and_keeps_each_sentence_once(tmp_path, labels):
    first = build(tables=tmp_path, labels=labels, scorer=HashScorer())
    scorer = HashScorer()
    build(tables=tmp_path, labels=labels, scorer=scorer, full_refresh=True)
    assert len(scorer.asked) == len(set(scorer.asked)) == first.sentences_scored
    parts = f"{tmp_path}/scores/*/part-*.parquet"
    counted = duckdb.sql(f"select count(*), count(distinct sentence) from '{parts}'").fetchall()
    assert counted == [(first.sentences_scored,) * 2]


def test_combinations_that_rooms_need(tmp_path, labels):
    rooms = tmp_path / "rooms.jsonl"
    lines = [{"room_id": "1", "objects": ["sink", "bed", "ghost"]}, {"room_id": "2", "objects": []}]
    rooms.write_text("\n".join(map(json.dumps, lines)))
    build(tables=tmp_path, labels=labels, scorer=HashScorer(), combinations=str(rooms))
    ((_, _, objects, *_),) = table(tmp_path, "query_scores", "key")
    assert set(objects) == {"sink", "bed"}


def test_imported_scores_need_no_model(tmp_path, labels):
    path = tmp_path / "scores.csv"
    pairs = [(o.label, r.label) for o in SPACE.objects for r in SPACE.rooms]
    values = {pair: -float(n) for n, pair in enumerate(pairs)}
    path.write_text(
        "object,room,log_prob\n" + "".join(f"{o},{r},{v}\n" for (o, r), v in values.items())
    )
    scorer = HashScorer()
    build(tables=tmp_path, labels=labels, scorer=scorer, scores=path, combinations="none")
    assert scorer.asked == []
    manifest = SpaceFolder(tmp_path, "small").current().manifest
    assert manifest.scorer_id.startswith("imported-")
    rows = table(tmp_path, "cooccurrence", "object, room")
    assert {(row[1], row[2]): row[4] for row in rows} == values


class Broken(HashScorer):
    """Gives no number from the tenth sentence on."""

    def score_of(self, sentence):
        if len(self.asked) > 9:
            return SentenceScore(math.nan, 3)
        return super().score_of(sentence)


def test_a_model_that_fails_publishes_nothing_and_leaves_what_was_good(tmp_path, labels):
    with pytest.raises(ModelError, match="nan for 'A room containing"):
        build(tables=tmp_path, labels=labels, scorer=Broken())
    assert SpaceFolder(tmp_path, "small").published() is None
    scorer = HashScorer()
    build(tables=tmp_path, labels=labels, scorer=scorer)
    assert len(scorer.asked) == 14 * 3 + 4 - 9


def test_a_failing_check_publishes_nothing(tmp_path, labels, monkeypatch):
    rows = "select source, object from entropy"
    pipeline = tmp_path / "pipeline"
    (pipeline / "checks").mkdir(parents=True)
    (pipeline / "checks" / "never.sql").write_text(rows)
    monkeypatch.setattr(builder, "pipeline_folder", lambda: pipeline)
    with pytest.raises(StoreError, match=r"check never failed.*'bed'"):
        build(tables=tmp_path, labels=labels, scorer=HashScorer())
    assert SpaceFolder(tmp_path, "small").published() is None


def test_bad_input_is_found_before_anything_is_scored(tmp_path, labels):
    scorer = HashScorer()
    with pytest.raises(InputError, match="cannot read"):
        build(tables=tmp_path / "t", labels=labels, scorer=scorer, counts=tmp_path / "absent.csv")
    assert scorer.asked == []
    assert not (tmp_path / "t").exists()


def test_every_check_is_one_select():
    for path in (pipeline_folder() / "checks").glob("*.sql"):
        assert len(duckdb.extract_statements(path.read_text())) == 1


def test_tables_of_an_older_schema_are_made_anew_from_the_scores(tmp_path, labels):
    """`build` keeps what is scored, and with `misses` the combinations that were published."""
    tables = tmp_path / "t"
    build(tables=tables, labels=labels, scorer=HashScorer(), k=2)
    space = SpaceFolder(tables, "small")
    version = space.current()
    manifest = json.loads((version.path / "manifest.json").read_text())
    (version.path / "manifest.json").write_text(json.dumps(manifest | {"schema_version": 1}))
    (space.path / "CURRENT").write_text(f"{version.name}\n")  # as version 1 wrote it
    with pytest.raises(StoreError, match="schema version 1"):
        RoomTables.open(tables, "small")
    scorer = HashScorer()
    report = build(tables=tables, labels=labels, scorer=scorer, k=2, combinations="misses")
    assert report.published
    assert scorer.asked == []
    assert space.current().manifest.combinations == {"proxy": 4 + 6}
    assert RoomTables.open(tables, "small", offline=True).classify(["bed"]).answered_by == "table"


def flat(tmp_path, objects, rooms):
    """The folder of label space ``flat``, with these rows."""
    folder = tmp_path / "flat"
    folder.mkdir()
    (folder / "objects.csv").write_text(objects)
    (folder / "rooms.csv").write_text(rooms)
    return str(folder)


def test_names_are_what_a_lookup_reads_as_it_stands(tmp_path):
    objects = "object,synonyms\nfridge,refrigerator|ice box\nstairs,\n"
    labels = flat(tmp_path, objects, "room\nkitchen\n")
    build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    rows = table(tmp_path / "t", "names", "name", labels="flat")
    assert rows == [
        ("fridge", "fridge", "label"),
        ("fridges", "fridge", "plural"),
        ("ice box", "fridge", "synonym"),
        ("ice boxes", "fridge", "plural"),
        ("refrigerator", "fridge", "synonym"),
        ("refrigerators", "fridge", "plural"),
        ("stair", "stairs", "plural"),
        ("stairs", "stairs", "label"),
    ]
    opened = RoomTables.open(tmp_path / "t", "flat", offline=True)
    for name, label, _ in rows:
        assert opened.classify([name]).objects == (label,)


@pytest.mark.parametrize("name", ["source", "Key", "objects"])
def test_a_room_cannot_bear_the_name_of_a_column(tmp_path, name):
    labels = flat(tmp_path, "object\nbed\n", f"room\n{name}\n")
    with pytest.raises(LabelSpaceError, match=f"a room cannot be called '{name.lower()}'"):
        build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    assert not (tmp_path / "t").exists()


def test_a_label_space_cannot_bear_the_name_of_the_scores(tmp_path):
    labels = str(write_space(tmp_path, small_space("flat")).rename(tmp_path / "scores"))
    with pytest.raises(LabelSpaceError, match="'scores': the tables folder uses this name"):
        build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())


def test_rooms_of_any_name_are_columns(tmp_path):
    rooms = 'room\n"a ""room"", \'x\'"\nselect\nbed room 2\n'
    labels = flat(tmp_path, "object\nbed\n", rooms)
    build(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    version = SpaceFolder(tmp_path / "t", "flat").current()
    names = pq.read_schema(version.path / "query_scores.parquet").names
    assert names == ["source", "key", "objects", "a \"room\", 'x'", "bed room 2", "select"]
    opened = RoomTables.open(tmp_path / "t", "flat", offline=True)
    assert opened.classify(["bed"]).probabilities.keys() == set(names[3:])
