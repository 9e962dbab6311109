"""Tables of several templates that name the room first, scored behind the room by a real model."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest

from roomtables import RoomTables, build
from roomtables.errors import ConfigError
from roomtables.labels import RoomLabel
from roomtables.offline.plan import plan
from roomtables.online.model import QueryModel
from support import HashScorer, small_space, write_space

FRAMES = ["Things found in {room}: {objects}.", "In {room} you see {objects}."]


def test_what_is_scored_and_the_templates_are_part_of_a_build(tmp_path) -> None:
    options = {
        "labels": str(write_space(tmp_path, small_space())),
        "tables": tmp_path / "t",
        "k": 2,
    }
    whole = build(**options, template=FRAMES)
    foreseen = plan(**options, template=FRAMES, scored="after_room", exact=True)
    assert "scored sentence → after_room" in {stage.why for stage in foreseen.stages}
    ends = build(**options, template=FRAMES, scored="after_room")
    assert ends.sentences_scored == whole.sentences_scored == foreseen.sentences_to_score
    assert not build(**options, template=FRAMES, scored="after_room").published
    assert build(**options, template=FRAMES).sentences_scored == 0


def test_the_model_asked_online_gives_what_a_build_writes(tmp_path) -> None:
    options = {"labels": str(write_space(tmp_path, small_space())), "k": 2}
    options |= {"template": FRAMES, "scored": "after_room"}
    build(**options, tables=tmp_path / "held")
    build(**options, tables=tmp_path / "none", combinations="none")
    held = RoomTables.open(tmp_path / "held", "small", offline=True).classify(["sink", "bed"])
    asked = RoomTables.open(tmp_path / "none", "small").classify(["sink", "bed"])
    assert (held.answered_by, asked.answered_by) == ("table", "lm")
    found, expected = (list(answer.probabilities.values()) for answer in (asked, held))
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.fixture(scope="module")
def worded(tmp_path_factory):
    """Tables of two templates, and what they should hold: S by object and room, by a plain loop."""
    folder = tmp_path_factory.mktemp("worded")
    space, scorer = small_space(), HashScorer()
    labels = str(write_space(folder, space))
    build(tables=folder / "t", labels=labels, template=FRAMES, scorer=scorer, k=1)
    expected = {}
    for thing in space.objects:
        per_template = []
        for frame in FRAMES:
            texts = [frame.format(room=r.phrase, objects=thing.plural) for r in space.rooms]
            scores = np.array([scorer.score_of(text).log_prob for text in texts])
            per_template.append(scores - np.log(np.exp(scores + 20).sum()) + 20)
        means = np.mean(per_template, axis=0)
        expected |= {(thing.label, r.label): s for r, s in zip(space.rooms, means, strict=True)}
    return folder / "t", scorer, expected


def test_a_score_is_the_mean_of_each_templates_log_softmax(worded) -> None:
    tables, _, expected = worded
    version = RoomTables.open(tables, "small", offline=True).version
    rows = pq.read_table(version.path / "cooccurrence.parquet").to_pylist()
    proxy = [row for row in rows if row["source"] == "proxy"]
    assert len(proxy) == len(expected) == 16
    for row in proxy:
        assert row["score"] == pytest.approx(expected[row["object"], row["room"]], abs=1e-9)
    for label in {row["object"] for row in proxy}:
        weights = {r: np.exp(s) for (o, r), s in expected.items() if o == label}
        for row in (row for row in proxy if row["object"] == label):
            share = weights[row["room"]] / sum(weights.values())
            assert row["p_room_given_object"] == pytest.approx(share, abs=1e-9)


def test_objects_asked_online_score_as_the_tables_hold_them(worded) -> None:
    tables, scorer, expected = worded
    space = small_space()
    manifest = RoomTables.open(tables, "small", offline=True).version.manifest
    found = QueryModel(manifest, scorer).score_singles(space.objects, space.rooms, space.rooms)
    assert found is not None
    for thing, scores in zip(space.objects, found, strict=True):
        row = [expected[thing.label, room.label] for room in space.rooms]
        assert scores.tolist() == pytest.approx(row, abs=1e-9)


def test_a_room_of_no_label_space_changes_no_others_score(worded) -> None:
    tables, scorer, expected = worded
    space, other = small_space(), RoomLabel("attic", "an", ())
    manifest = RoomTables.open(tables, "small", offline=True).version.manifest
    thing = space.objects[0]
    [scores] = QueryModel(manifest, scorer).score_singles(
        [thing], [other, space.rooms[0]], space.rooms
    )
    assert scores[1] == pytest.approx(expected[thing.label, space.rooms[0].label], abs=1e-9)


@pytest.mark.parametrize(
    ("template", "says"),
    [
        (["A room with {objects} is {room}."], "names the room last"),
        (["In {room} {objects}."], "no word between"),
        ([FRAMES[0], FRAMES[0]], "twice"),
    ],
)
def test_templates_that_do_not_fit_are_refused(tmp_path, template, says) -> None:
    with pytest.raises(ConfigError, match=says):
        build(tables=tmp_path / "t", template=template, scored="after_room")
    assert not (tmp_path / "t").exists()
