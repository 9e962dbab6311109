"""Temperature, unknown rooms, weights and evidence, on the tables of a few lines of arithmetic."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from roomtables import RoomTables, evaluate
from roomtables.cli import main
from roomtables.errors import ConfigError, InputError
from roomtables.online.classifier import classify_rooms
from roomtables.rooms import Room, parse_room
from tiny_tables import OBJECTS, build_tables

SOME = st.lists(st.sampled_from([*OBJECTS, "piano"]), min_size=1, max_size=6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build_tables(tmp_path_factory.mktemp("unsure"))


@pytest.fixture(scope="module")
def tables(folder):
    return RoomTables.open(folder, "flat", rule="pooled", offline=True)


def softmax(values):
    e = np.exp(values - np.max(values))
    return e / e.sum()


@pytest.mark.parametrize("temperature", [0.5, 1.0, 7.0])
def test_temperature_divides_what_is_compared(tables, temperature):
    cool = tables.deciding(temperature=temperature).classify(["bed", "oven"])
    plain = tables.classify(["bed", "oven"])
    expected = softmax(plain.compared / temperature)
    assert list(cool.probabilities.values()) == pytest.approx(expected.tolist())
    assert cool.room == plain.room


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rule", ["query", "pooled"])
def test_a_temperature_near_zero_leaves_only_the_best(tables, rule):
    found = tables.deciding(rule=rule, temperature=1e-320).classify(["bed", "oven"])
    assert found.probability in {0.5, 1.0}  # the two may tie
    assert sum(found.probabilities.values()) == 1.0


def test_auto_temperature_is_the_sum_of_the_weights(tables):
    auto = tables.deciding(temperature="auto").classify(["bed", "oven", "lamp"])
    assert auto.temperature == pytest.approx(sum(said.weight for said in auto.evidence))
    # An object alone is then said as the model says it: its weight cancels.
    alone = tables.deciding(temperature="auto", prior_weight=0.0).classify(["bed"])
    number = [o.label for o in tables.lookup.objects].index("bed")
    scores = tables.lookup.sources["proxy"].room_logits[number]
    assert list(alone.probabilities.values()) == pytest.approx(softmax(scores).tolist())
    assert tables.deciding(rule="query", temperature="auto").classify(["bed"]).temperature == 1


@pytest.mark.parametrize("settings", [
    {"temperature": 0.0}, {"temperature": -1.0}, {"temperature": math.nan},
    {"temperature": math.inf}, {"min_probability": 1.5}, {"min_probability": math.nan},
])  # fmt: skip
def test_numbers_that_make_no_sense_are_refused(tables, settings):
    with pytest.raises(ConfigError, match=next(iter(settings)).replace("_", " ")):
        tables.deciding(**settings)


@pytest.mark.parametrize("rule", ["query", "pooled"])
def test_below_the_minimum_a_room_stays_unknown_with_a_reason(tables, rule):
    plain = tables.deciding(rule=rule, temperature=100.0)
    sure = plain.deciding(min_probability=0.99)
    found = sure.classify(["bed", "oven"])
    (batched,) = sure.classify_many([["bed", "oven"]])
    for unsure in (found, batched):
        assert unsure.room is None
        assert "below 0.99" in unsure.reason
        assert unsure.answered_by == "table"
        assert unsure.probabilities == plain.classify(["bed", "oven"]).probabilities
    assert sure.classify_many([["bed", "oven"]]).rooms == [None]
    nothing = sure.classify(["piano"])
    assert (nothing.room, nothing.reason, nothing.answered_by) == (None, None, "none")
    assert plain.deciding(min_probability=0.01).classify(["bed"]).room is not None


def test_an_unsure_room_counts_as_wrong(tables):
    rooms = [Room("1", ("bed",), ("bedroom",)), Room("2", ("chair", "bed", "oven"), ("kitchen",))]
    found = evaluate(rooms, tables.deciding(temperature=50.0, min_probability=0.9))
    assert (found.rooms, found.correct) == (2, 0)


@given(SOME)
def test_evidence_adds_up_to_what_is_compared(tables, objects):
    found = tables.classify(objects)
    if found.compared is None:
        assert found.evidence == ()
        return
    best, runner_up = np.sort(found.compared)[::-1][:2]
    assert sum(e.room_nats for e in found.evidence) == pytest.approx(best)
    assert sum(e.runner_up_nats for e in found.evidence) == pytest.approx(runner_up)
    assert {e.room for e in found.evidence} == {found.room}
    assert {e.object for e in found.evidence} == set(objects) - {"piano"}


def test_rule_query_counts_the_picked(tables):
    found = tables.deciding(rule="query").classify(list(OBJECTS))
    assert [e.object for e in found.evidence if e.counted] == list(found.objects)


@given(SOME)
def test_duplicates_count_only_when_asked(tables, objects):
    once = Room("1", tuple(dict.fromkeys(objects)))
    twice = Room("1", tuple(objects) * 2)
    plain, doubled = (classify_rooms(tables, [room])[0] for room in (once, twice))
    assert plain.as_json() == doubled.as_json()
    counted = classify_rooms(tables, [once], "counts")[0]
    assert counted.room == plain.room
    assert counted.probabilities == pytest.approx(plain.probabilities)


def test_counts_and_confidences_are_factors_of_the_weight(tables):
    plain = {e.object: e for e in tables.classify(["bed", "oven"]).evidence}
    line = {"room_id": "1", "objects": ["bed", "stove"], "counts": [4, 1], "confidences": [0.5, 0]}
    room = parse_room(line, "line 1")
    (counted,) = classify_rooms(tables, [room], "counts")
    (sure,) = classify_rooms(tables, [room], "confidences")
    weights = {e.object: e.weight for e in counted.evidence}
    assert weights["bed"] == pytest.approx((1 + math.log(4)) * plain["bed"].weight)
    assert weights["oven"] == pytest.approx(plain["oven"].weight)
    weights = {e.object: e.weight for e in sure.evidence}
    assert weights == {"bed": pytest.approx(0.5 * plain["bed"].weight), "oven": 0.0}
    repeated = Room("1", ("bed",) * 4 + ("oven",))
    assert classify_rooms(tables, [repeated], "counts")[0].probabilities == counted.probabilities


@pytest.mark.parametrize("values", [[1], [1, -1], [1, "2"], [1, True], [1, math.nan], [1, None]])
def test_malformed_counts_matter_only_when_asked(tables, values):
    room = parse_room({"room_id": "r9", "objects": ["bed", "oven"], "counts": values}, "line 1")
    assert classify_rooms(tables, [room])[0].room == tables.classify(["bed", "oven"]).room
    with pytest.raises(InputError, match=r"'r9'.*counts"):
        classify_rooms(tables, [room], "counts")


def test_weights_need_rule_pooled(tables):
    with pytest.raises(ConfigError, match="--rule pooled"):
        classify_rooms(tables.deciding(rule="query"), [Room("1", ("bed",))], "counts")


def test_classify_command(folder, tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text('{"room_id": "1", "objects": ["bed", "oven"], "confidences": [0, 1]}\n')
    common = ["classify", "--tables", str(folder), "--labels", "flat", "--offline"]

    def run(*arguments):
        found = CliRunner().invoke(main, [*common, *arguments])
        assert found.exit_code == 0, found.output
        return found.stdout

    pooled = ("--input", str(rooms), "--rule", "pooled", "--format", "jsonl")
    plain = json.loads(run(*pooled))
    assert {"reason", "evidence"}.isdisjoint(plain)
    told = json.loads(run(*pooled, "--weights", "confidences", "--explain"))
    assert told["room"] == "kitchen"
    assert {e["object"]: e["weight"] > 0 for e in told["evidence"]} == {"bed": False, "oven": True}
    unsure = json.loads(run(*pooled, "--temperature", "auto", "--min-probability", "1"))
    assert unsure["room"] is None
    assert "below 1" in unsure["reason"]
    assert "why bedroom rather than" in run("bed", "lamp", "--explain", "--rule", "pooled")
    bad = CliRunner().invoke(main, [*common, "bed", "--temperature", "warm"])
    assert bad.exit_code == 2
