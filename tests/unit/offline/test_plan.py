"""What `plan` says is what `build` then does, and saying it writes nothing."""

import json

import pytest

from roomtables import build
from roomtables.config import BuildConfig
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.offline import stages
from roomtables.offline.plan import plan
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

SPACE = small_space()


def states(found):
    return {stage.stage: (stage.state, stage.why) for stage in found.stages}


def agrees(tables, name="hash@1", **options):
    """Plan by formula and by the cache, build, compare; returns the plan by cache, the report."""
    bound = plan(tables=tables, scorer=HashScorer(name), **options)
    planned = plan(tables=tables, scorer=HashScorer(name), exact=True, **options)
    scorer = HashScorer(name)
    report = build(tables=tables, scorer=scorer, **options)
    if planned.exact:
        assert planned.sentences_to_score == report.sentences_scored == len(scorer.asked)
    else:
        assert planned.sentences_to_score >= report.sentences_scored == len(scorer.asked)
    assert bound.sentences_to_score >= report.sentences_scored
    assert not bound.exact or bound.sentences_to_score == report.sentences_scored
    held = SpaceFolder(tables, planned.labels).current().manifest.combinations
    assert bound.coverage.held >= planned.coverage.held >= sum(held.values())
    assert report.published == any(stage.state != "cached" for stage in planned.stages)
    again = plan(tables=tables, scorer=HashScorer(name), **(options | {"full_refresh": False}))
    assert {stage.state for stage in again.stages} == {"cached"}
    assert again.sentences_to_score == 0
    return planned, report


def test_the_stages_are_those_of_build_toml(tmp_path, labels):
    found = plan(tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    assert [stage.stage for stage in found.stages] == list(BuildConfig.load().stages)


def test_a_plan_writes_nothing_and_asks_nothing(tmp_path, labels, counts):
    tables = tmp_path / "t"
    scorer = HashScorer()
    found = plan(tables=tables, labels=labels, scorer=scorer, counts=counts)
    assert set(states(found).values()) == {("missing", "not built")}
    assert scorer.asked == []
    assert not tables.exists()
    build(tables=tables, labels=labels, scorer=scorer)
    before = {path: path.stat().st_mtime_ns for path in tables.rglob("*")}
    plan(tables=tables, labels=labels, scorer=scorer, counts=counts)
    assert {path: path.stat().st_mtime_ns for path in tables.rglob("*")} == before


def test_from_nothing(tmp_path, labels):
    planned, _ = agrees(tmp_path / "t", labels=labels)
    assert planned.exact
    assert planned.sentences_to_score == 4 * 4 + 10 * 3
    assert planned.seconds is None
    assert sum(stage.sentences for stage in planned.stages) == planned.sentences_to_score


def test_what_costs_nothing_more(tmp_path, labels):
    agrees(tmp_path / "t", labels=labels)
    planned, _ = agrees(tmp_path / "t", labels=labels)
    assert set(states(planned).values()) == {("cached", "")}


def test_two_sources_are_at_most(tmp_path, labels, counts):
    planned, _ = agrees(tmp_path / "t", labels=labels, counts=counts)
    assert not planned.exact
    assert planned.coverage.combinations == 2 * 14


def test_counts_that_come_later_are_exact(tmp_path, labels, counts):
    agrees(tmp_path / "t", labels=labels)
    planned, _ = agrees(tmp_path / "t", labels=labels, counts=counts)
    assert planned.exact
    found = states(planned)
    assert (
        found["cooccurrence"]
        == found["entropy"]
        == found["lookup"]
        == ("stale", "counts.csv added")
    )
    assert found["objects"] == found["rooms"] == ("cached", "")


def test_another_model(tmp_path, labels):
    agrees(tmp_path / "t", labels=labels)
    planned, _ = agrees(tmp_path / "t", "hash@2", labels=labels)
    found = states(planned)
    assert (
        found["sentence_scores"]
        == found["entropy"]
        == ("stale", "hash: weights, tokenizer or device changed")
    )
    assert found["objects"] == ("cached", "")
    planned, _ = agrees(tmp_path / "t", labels=labels)  # back: all is held still
    assert planned.sentences_to_score == 0


def test_another_code(tmp_path, labels, monkeypatch):
    agrees(tmp_path / "t", labels=labels)
    real = stages.stage_sql

    def changed(name):
        sql = real(name)
        return f"{sql}--" if name == "entropy" else sql

    monkeypatch.setattr(stages, "stage_sql", changed)
    planned, report = agrees(tmp_path / "t", labels=labels)
    assert report.sentences_scored == 0
    assert states(planned) == {
        "objects": ("cached", ""),
        "rooms": ("cached", ""),
        "names": ("cached", ""),
        "sentence_scores": ("cached", ""),
        "cooccurrence": ("cached", ""),
        "entropy": ("stale", "entropy.sql changed"),
        "room_bias": ("cached", ""),
        "queries": ("stale", "entropy.sql changed"),
        "query_scores": ("stale", "entropy.sql changed"),
        "lookup": ("stale", "entropy.sql changed"),
    }


def test_full_refresh(tmp_path, labels, counts):
    agrees(tmp_path / "t", labels=labels, counts=counts)
    planned, report = agrees(tmp_path / "t", labels=labels, counts=counts, full_refresh=True)
    assert planned.exact
    assert report.sentences_cached == 0
    assert states(planned)["sentence_scores"] == ("stale", "full refresh")


def test_a_new_object_asks_only_sentences_that_hold_it(tmp_path, labels):
    agrees(tmp_path / "t", labels=labels)
    objects = (*SPACE.objects, *LabelSpace.named("x", ["lamp"], ["x"]).objects)
    write_space(tmp_path / "labels", LabelSpace("small", objects, SPACE.rooms))
    scorer = HashScorer()
    planned = plan(tables=tmp_path / "t", labels=labels, scorer=scorer, exact=True)
    report = build(tables=tmp_path / "t", labels=labels, scorer=scorer)
    assert planned.exact
    assert planned.sentences_to_score == report.sentences_scored == len(scorer.asked)
    assert all("lamps" in sentence for sentence in scorer.asked)
    # one single per room, and the query sentences of lamp with one or two of the four others
    assert report.sentences_scored == 4 + 3 * (4 + 6)


def test_a_removed_part_asks_only_what_it_held(tmp_path, labels):
    tables = tmp_path / "t"
    build(tables=tables, labels=labels, scorer=HashScorer(), k=1)
    (before,) = (tables / "scores" / "hash@1").glob("part-*")
    build(tables=tables, labels=labels, scorer=HashScorer())
    (part,) = set((tables / "scores" / "hash@1").glob("part-*")) - {before}
    part.unlink()
    planned, report = agrees(tables, labels=labels)
    assert states(planned)["query_scores"] == ("missing", "score part missing")
    assert states(planned)["sentence_scores"] == ("cached", "")
    assert report.sentences_scored == 10 * 3


def test_a_removed_table_is_made_again_from_the_scores(tmp_path, labels):
    tables = tmp_path / "t"
    build(tables=tables, labels=labels, scorer=HashScorer())
    (SpaceFolder(tables, "small").current().path / "entropy.parquet").unlink()
    planned, report = agrees(tables, labels=labels)
    assert states(planned)["entropy"] == ("missing", "entropy.parquet missing")
    assert report.sentences_scored == 0
    SpaceFolder(tables, "small").current().verify()


def test_a_damaged_part_is_named(tmp_path, labels):
    build(tables=tmp_path, labels=labels, scorer=HashScorer())
    part = next((tmp_path / "scores" / "hash@1").glob("part-*"))
    content = bytearray(part.read_bytes())
    content[len(content) // 3] ^= 1
    part.write_bytes(content)
    for command in (plan, build):
        with pytest.raises(StoreError, match=rf"{part.name} is damaged.*roomtables build"):
            command(tables=tmp_path, labels=labels, scorer=HashScorer())


def test_combinations_of_rooms(tmp_path, labels):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text(json.dumps({"room_id": "1", "objects": ["sink", "bed", "stove", "toilet"]}))
    planned, _ = agrees(tmp_path / "t", labels=labels, combinations=str(rooms))
    assert not planned.exact  # which three of the four are asked about is not known yet
    assert planned.sentences_to_score == 4 * 4 + 3
    assert planned.coverage.held == 1
    assert planned.coverage.rest_sentences == 13 * 3


def test_the_rate_of_the_last_build_tells_how_long(tmp_path, labels):
    build(tables=tmp_path, labels=labels, scorer=HashScorer())
    found = plan(tables=tmp_path, labels=labels, scorer=HashScorer(), full_refresh=True)
    assert found.sentences_per_second is not None
    assert found.seconds == round(46 / found.sentences_per_second, 1)
    assert found.tokens is not None
    assert found.tokens > 46 * 8


def test_no_model_no_sentences(tmp_path, labels):
    path = tmp_path / "scores.csv"
    rows = [f"{o.label},{r.label},-1\n" for o in SPACE.objects for r in SPACE.rooms]
    path.write_text("object,room,log_prob\n" + "".join(rows))
    options = {"labels": labels, "scores": path, "combinations": "none"}
    planned, _ = agrees(tmp_path / "t", **options)
    assert (planned.sentences_to_score, planned.scorer_id) == (0, None)
