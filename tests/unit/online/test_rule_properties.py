"""What must hold of every table: properties, and the naive product as independent reference."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roomtables import RoomTables, build
from roomtables.errors import InputError, ModelError
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel
from roomtables.online import rules
from roomtables.online.decision import Decision
from roomtables.online.model import QueryModel
from roomtables.scorer import SentenceScore
from roomtables.storage.lookup import Lookup, SourceArrays
from roomtables.storage.versions import Version
from support import HashScorer, made_manifest, small_space, write_space

SCORES = arrays(np.float64, st.tuples(st.integers(1, 5), st.integers(1, 6)),
                elements=st.floats(-400, 0))  # fmt: skip


@given(SCORES)
def test_probabilities_sum_to_one_and_entropy_is_in_range(scores):
    logs = rules.log_softmax(scores)
    assert np.exp(logs).sum(axis=-1) == pytest.approx(1)
    entropies = rules.entropy(logs)
    assert (entropies >= 0).all()
    assert (entropies <= math.log(scores.shape[1]) + 1e-9).all()


def pooled(scores, bias=None, prior_weight=0.5, evidence_power=3.0):
    """The answer by rule pooled for a room of all the objects that have these S(o, r)."""
    objects, rooms = ([chr(ord("a") + at) for at in range(size)] for size in scores.shape)
    space = LabelSpace(
        "letters",
        tuple(ObjectLabel(label, f"many {label}") for label in objects),
        tuple(RoomLabel(label, "a") for label in rooms),
    )
    arrays = SourceArrays(
        entropy=np.arange(len(objects), dtype=float),
        ranks=np.arange(1, 1 + len(objects)),
        room_logits=scores,
        bias=rules.room_bias(scores) if bias is None else bias,
        keys=np.zeros(0, np.uint64),
        scores=np.zeros((0, len(rooms)), np.float32),
    )
    lookup = Lookup(
        space.objects, space.rooms, space.object_aliases, space.room_aliases,
        3, ("{objects} {room}",), "sentence", "sum", {"proxy": arrays},
    )  # fmt: skip
    manifest = made_manifest(Path("nowhere"), labels=space.name)
    model = QueryModel(manifest, allowed=False)
    decision = Decision("pooled", "proxy", prior_weight, evidence_power)
    return RoomTables(Version(Path(), manifest), lookup, model, decision).classify(objects)


@given(SCORES)
def test_without_prior_and_power_it_is_the_naive_product(scores):
    product = np.zeros(scores.shape[1])
    for row in scores.tolist():
        highest = max(row)
        total = math.log(sum(math.exp(s - highest) for s in row))
        product += [s - highest - total for s in row]
    found = pooled(scores, prior_weight=0.0, evidence_power=0.0).compared
    assert found == pytest.approx(product, rel=1e-9, abs=1e-9)


@given(SCORES, st.floats(0, 2), st.floats(0, 4), st.randoms())
def test_the_order_of_rooms_changes_nothing(scores, prior_weight, evidence_power, random):
    order = list(range(scores.shape[1]))
    random.shuffle(order)
    plain, permuted = (
        pooled(array, None, prior_weight, evidence_power).compared
        for array in (scores, scores[:, order])
    )
    assert permuted == pytest.approx(plain[order], rel=1e-6, abs=1e-6)


def test_equal_scores_say_nothing_and_impossible_ones_no_nan():
    assert np.all(pooled(np.zeros((1, 4))).compared == 0)
    hopeless = np.full((1, 4), -np.inf)
    assert np.exp(rules.log_softmax(hopeless)) == pytest.approx(0.25)
    one = np.array([[0.0, -np.inf, -np.inf, -np.inf]])
    found = pooled(one, bias=np.zeros(4))
    assert found.compared[0] == 0
    assert np.isneginf(found.compared[1:]).all()
    # An object that is sure of another room, but of which nothing is believed: no 0 × −inf.
    assert np.all(found.weighed({"a": 0.0}).compared == 0)


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("properties")
    labels = str(write_space(folder / "labels", small_space()))
    build(tables=folder / "t", labels=labels, scorer=HashScorer())
    return RoomTables.open(folder / "t", "small", offline=True)


@given(st.permutations(["bed", "sink", "stove", "toilet", "sink"]), st.sampled_from(
    ["query", "calibrated", "pooled"]))  # fmt: skip
def test_the_order_of_objects_changes_nothing(tables, objects, rule):
    tables = tables.deciding(rule=rule)
    plain = tables.classify(["bed", "sink", "stove", "toilet"])
    assert tables.classify(objects).as_json() == plain.as_json()


def opened(folder, text_rooms, scorer=None, **options):
    labels = folder / "space"
    labels.mkdir(exist_ok=True)
    (labels / "objects.csv").write_text("object\nbed\nlamp\n")
    (labels / "rooms.csv").write_text("room\n" + text_rooms)
    build(tables=folder / "t", labels=str(labels), scorer=scorer or HashScorer(), **options)
    return RoomTables.open(folder / "t", "space", offline=True)


@pytest.mark.parametrize("rule", ["query", "calibrated", "pooled"])
def test_a_label_space_of_one_room_is_always_that_room(tmp_path, rule):
    found = opened(tmp_path, "cave\n").deciding(rule=rule).classify(["bed", "lamp"])
    assert (found.room, found.probability) == ("cave", 1.0)
    assert {e.runner_up for e in found.evidence} == {None}


@pytest.mark.parametrize("rule", ["query", "calibrated", "pooled"])
def test_scores_that_are_all_equal_tie_to_the_first_room(tmp_path, rule):
    class Flat(HashScorer):
        def score_of(self, sentence):
            return SentenceScore(-3.0, 3)

    tables = opened(tmp_path, "den\nattic\ncave\n", Flat("flat@1")).deciding(rule=rule)
    found = tables.classify(["bed"])
    assert found.room == "attic"
    assert list(found.probabilities.values()) == pytest.approx([1 / 3] * 3)


def test_zero_counts_everywhere_say_nothing(tmp_path):
    counts = tmp_path / "counts.csv"
    counts.write_text("object,room,count\nbed,cave,0\n")
    for smoothing in (0, None):
        tables = opened(tmp_path, "den\ncave\n", counts=counts, smoothing=smoothing)
        found = tables.deciding(rule="pooled", source="ground_truth").classify(["bed", "lamp"])
        assert found.room == "cave"
        assert list(found.probabilities.values()) == pytest.approx([0.5] * 2)


@pytest.mark.parametrize("score", [math.nan, -math.inf, math.inf])
def test_scores_that_are_not_finite_are_refused(tmp_path, score):
    class Broken(HashScorer):
        def score_of(self, sentence):
            return SentenceScore(score, 3)

    with pytest.raises(ModelError):
        opened(tmp_path, "den\ncave\n", Broken("broken@1"))
    scores = tmp_path / "scores.csv"
    scores.write_text(f"object,room,log_prob\nbed,den,{score}\n")
    with pytest.raises(InputError, match=r"scores\.csv, line 2"):
        opened(tmp_path, "den\ncave\n", scores=scores)
