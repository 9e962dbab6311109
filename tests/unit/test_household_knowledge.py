"""The knowledge by its own Bayes rule, without any language model, on rooms made up by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pipeline.household_lm.bayes import log_presence
from pipeline.household_lm.facts import load_facts
from pipeline.household_lm.knowledge_scores import knowledge_scores
from pipeline.household_lm.label_space import MERGED, ROOMS

from roomtables.config import load_labels
from roomtables.names import NameReader

EVERYDAY = Path(__file__).parents[1] / "data" / "everyday_rooms.jsonl"
SHARE_RIGHT = 0.85  # 89 % as the files are; a few rooms on the list may be either of two

FACTS = load_facts()
PRESENCE = log_presence(FACTS)
THINGS = {name: row for row, name in enumerate(FACTS.things)}
COLUMNS = {name: column for column, name in enumerate(FACTS.rooms)}
READER = NameReader(load_labels("household").object_names)


def best_room(names: list[str]) -> str:
    """The candidate of label space household in which the named objects are most probable."""
    labels = [READER.read(name).label for name in names]
    return max(ROOMS, key=lambda room: sum(PRESENCE[THINGS[o], COLUMNS[room]] for o in labels))


def test_most_everyday_rooms_are_told_by_their_objects():
    rooms = [json.loads(line) for line in EVERYDAY.read_text(encoding="utf-8").splitlines()]
    pairs = [(MERGED.get(row["room"], (row["room"],))[0], row["objects"]) for row in rooms]
    told = [(room, best_room(names)) for room, names in pairs if room in ROOMS]
    right = sum(room == best for room, best in told)
    assert len(told) > 140
    assert right / len(told) >= SHARE_RIGHT, [pair for pair in told if pair[0] != pair[1]]


@pytest.mark.parametrize(
    ("room", "objects"),
    [
        ("bathroom", "sink;towel;shower"),
        ("kitchen", "refrigerator;oven;microwave;sink;dining table;chair;bottle;cup"),
        ("office", "laptop;keyboard;mouse;chair;tv;cup;book"),
        ("garage", "car;bicycle;shelf;box;door"),
        ("kitchen", "stove;refrigerator;cabinet;sink;dishwasher;countertop"),
        ("laundry room", "washing machine;dryer;laundry basket;detergent;clothes;hanger"),
        ("classroom", "blackboard;desk;chair;projector;bulletin board"),
        ("conference room", "conference table;chair;whiteboard;projector"),
        ("hospital room", "hospital bed;iv drip;curtain;wheelchair;monitor"),
        ("workshop", "kiln"),
        ("living room", "knitting needle"),
    ],
)
def test_rooms_that_models_have_got_wrong_are_clear_in_the_knowledge(room, objects):
    assert best_room(objects.split(";")) == room


def test_a_bland_thing_is_stated_for_nearly_every_room():
    for thing in ("wall", "light", "lighting", "chair", "cabinet", "picture", "object", "door"):
        rooms = FACTS.rooms.values()
        stated = sum(thing in room.objects or thing in room.never for room in rooms)
        assert stated >= 0.9 * len(rooms), thing


def test_the_knowledges_scores_are_bayes_rule_for_one_object():
    scores = {(o, r): score for o, r, score in knowledge_scores("mpcat40")}
    assert len(scores) == 35 * 27
    toilet = PRESENCE[THINGS["toilet"]]
    posterior = toilet - np.log(np.exp(toilet).sum())
    assert scores["toilet", "bathroom"] == pytest.approx(posterior[COLUMNS["bathroom"]], abs=1e-12)
    assert scores["toilet", "none"] == pytest.approx(posterior.min(), abs=1e-12)
