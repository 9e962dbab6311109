"""Label space household: in step with the knowledge, and what it makes of robots' names."""

from __future__ import annotations

import pytest
from pipeline.household_lm import inflections, label_space, name_lists
from pipeline.household_lm.facts import load_facts
from pipeline.household_lm.name_lists import Counts, read_list

from roomtables.config import load_labels
from roomtables.english import NOTED
from roomtables.names import NameReader

# Of these lists at least so much of the household objects is read.
LEAST = dict.fromkeys(("coco", "ade20k", "hydra", "ai2thor", "mpcat40", "nyuclass"), 0.95)


@pytest.fixture(scope="module")
def reader():
    return NameReader(load_labels("household").object_names)


def test_the_files_are_in_step_with_the_knowledge():
    made = label_space.label_space(load_facts(), label_space.other_names())
    for file, text in made.csv_files().items():
        assert (label_space.FOLDER / file).read_text(encoding="utf-8") == text, (
            f"{file}: run `python -m pipeline.household_lm.label_space`"
        )


def test_every_room_of_the_knowledge_is_a_candidate_or_merged_or_left_out_once():
    named = [*label_space.ROOMS, *label_space.MERGED, *label_space.LEFT_OUT]
    assert sorted(named) == sorted(load_facts().rooms)
    assert {room for room, _ in label_space.MERGED.values()} <= set(label_space.ROOMS)
    assert 30 <= len(label_space.ROOMS) <= 45


def test_merged_rooms_and_their_synonyms_are_read_as_the_room_that_they_are_merged_into():
    aliases = load_labels("household").room_aliases
    assert aliases["family room"] == aliases["tv room"] == "living room"
    for name, (room, _) in label_space.MERGED.items():
        assert aliases[name] == room


def test_further_names_are_of_objects_that_there_are():
    assert set(label_space.other_names()) <= set(load_facts().things)


def test_inflections_are_in_step_with_the_label_spaces():
    assert NOTED.read_text(encoding="utf-8") == inflections.inflections(), (
        "run `python -m pipeline.household_lm.inflections`"
    )


@pytest.mark.parametrize("name", name_lists.TITLES)
def test_each_name_of_a_list_is_read_as_it_says(name, reader):
    entries = read_list(name)
    assert len({entry.name for entry in entries}) == len(entries)
    for entry in entries:
        found = reader.read(entry.name)
        assert not entry.object or (found and found.label == entry.object), entry
        if "read as" in entry.why:  # another thing; else the list is behind the reader
            assert found, entry
    assert all(bool(entry.object) != bool(entry.why) for entry in entries)
    assert Counts.of(entries).share >= LEAST.get(name, 0.75)


def test_the_readme_states_the_counts():
    assert name_lists.README.read_text(encoding="utf-8") == name_lists.readme(), (
        "run `python -m pipeline.household_lm.name_lists`"
    )
