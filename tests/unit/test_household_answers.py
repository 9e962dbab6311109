"""What a text's next names should be, given what it told: Bayes' rule, worked by hand."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

pytest.importorskip("tokenizers")

from pipeline.household_lm.answers import Posterior
from pipeline.household_lm.bayes import log_posterior, log_presence
from pipeline.household_lm.facts import Facts, Room, Thing, load_facts
from pipeline.household_lm.generate import Writer, documents
from pipeline.household_lm.marks import MARKS, Answer, Evidence, Marked, marked
from pipeline.household_lm.packing import train_tokenizer
from pipeline.household_lm.world import World


def _room(name: str, synonyms: tuple[str, ...], objects: dict[str, float]) -> Room:
    return Room(name, synonyms, "home", ("rest",), ("quiet",), (), objects, ("moon",))


FACTS = Facts(
    {
        room.name: room
        for room in (
            _room("kitchen", (), {"lamp": 0.5}),
            _room("bedroom", ("chamber",), {"lamp": 0.5, "bed": 0.5}),
            _room("office", (), {"lamp": 0.9, "bed": 0.1}),
        )
    },
    {n: Thing(n, "thing", f"a {n}", "see", ("there",), ()) for n in ("lamp", "bed", "moon")},
)


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    return Posterior(World(FACTS), train_tokenizer(load_facts(), 3000, count=2000))


def _by_name(posterior: Posterior, text: str, mark: Marked, word: str) -> dict[str, float]:
    """The probabilities that are the target of the token of a word."""
    document = posterior.document(text, [mark])
    words = [posterior.tokenizer.decode([token]).strip() for token in document.ids]
    [target] = [target for target in document.answers if words[target.place] == word]
    names = [posterior.tokenizer.decode([int(token)]).strip() for token in target.tokens]
    return dict(zip(names, target.shares.tolist(), strict=True))


def test_an_object_that_a_room_does_not_name_is_rarer_where_it_is_rare_everywhere() -> None:
    presence = np.exp(log_presence(FACTS))
    assert presence[0].tolist() == pytest.approx([0.5, 0.5, 0.9])
    # Beds: half of their mean over the rooms is 0.1, more than 0.02 at most.
    assert presence[1].tolist() == pytest.approx([0.02, 0.5, 0.1])
    # Moons: named nowhere, and never there.
    assert presence[2].tolist() == pytest.approx([1e-4 / 4] * 3)


def test_the_posterior_multiplies_objects() -> None:
    exact = np.exp(log_posterior(FACTS, [["lamp", "bed"], ["moon"]]))
    joint = [0.5 * 0.02, 0.5 * 0.5, 0.9 * 0.1]
    assert exact[0].tolist() == pytest.approx([value / sum(joint) for value in joint])
    assert exact[1].tolist() == pytest.approx([1 / 3] * 3)


def test_the_answer_is_bayes_rule_over_names(posterior: Posterior) -> None:
    text = f"Lamps are in the {marked('bedroom')}."
    found = _by_name(posterior, text, Answer("bedroom", "the", ("lamp",)), "bedroom")
    # "chamber" weighs 0.3 beside the bedroom's own name.
    total = 0.5 + 0.5 + 0.5 * 0.3 + 0.9
    assert found["kitchen"] == pytest.approx(0.5 / total, rel=1e-5)
    assert found["bedroom"] == pytest.approx(0.5 / total, rel=1e-5)
    assert found["office"] == pytest.approx(0.9 / total, rel=1e-5)
    assert sum(found.values()) == pytest.approx(1)


def test_an_object_that_is_told_twice_counts_once(posterior: Posterior) -> None:
    text = f"Beds, beds are in the {marked('bedroom')}."
    once, twice = (
        _by_name(posterior, text, Answer("bedroom", "the", told), "bedroom")
        for told in (("bed",), ("bed", "bed"))
    )
    assert once == twice


def test_an_article_that_is_written_rules_names_out(posterior: Posterior) -> None:
    text, mark = f"Lamps: an {marked('office')}.", Answer("office", "a", ("lamp",))
    found = _by_name(posterior, text, mark, "office")
    assert found["office"] == pytest.approx(1)
    assert found["kitchen"] == 0
    article = _by_name(posterior, text, mark, "an")
    assert article == pytest.approx({"a": 1 - 0.9 / 2.05, "an": 0.9 / 2.05}, rel=1e-5)


def test_what_is_told_is_known_at_every_place_up_to_the_name(posterior: Posterior) -> None:
    text = f"Here {marked('lamps')} of old make a {marked('bedroom')}.{marked('')} Then more."
    marks: list[Marked] = [
        Evidence(("lamp",)),
        Answer("bedroom", "a", ("lamp",), then=Evidence(("lamp",), "bedroom")),
        Evidence(),
    ]
    document = posterior.document(text, marks)
    words = [posterior.tokenizer.decode([token]).strip() for token in document.ids]
    assert [words[place] for place in document.rooms] == ["of", "old", "make"]
    assert [words[place] for place in document.objects] == ["."]
    names = [posterior.tokenizer.decode([int(t)]).strip() for t in posterior.room_tokens]
    for shares in document.rooms.values():
        assert shares[names.index("office")] == pytest.approx(0.9 / 2.05, rel=1e-5)
    things = [posterior.tokenizer.decode([int(t)]).strip() for t in posterior.object_tokens]
    [shares] = document.objects.values()
    assert shares[things.index("beds")] == pytest.approx(1)


def test_a_name_of_two_words_is_told_to_its_end(posterior: Posterior) -> None:
    facts = load_facts()
    whole = Posterior(World(facts), posterior.tokenizer)
    text = f"Beds are in the {marked('living room')}."
    document = whole.document(text, [Answer("living room", "the", ("sofa",))])
    words = [whole.tokenizer.decode([token]).strip() for token in document.ids]
    assert [words[target.place] for target in document.answers] == ["living", "room"]
    for target in document.answers:
        assert math.fsum(target.shares) == pytest.approx(1, abs=1e-5)
        assert document.ids[target.place] in target.tokens


def test_marks_change_nothing_else() -> None:
    facts = load_facts()
    writer = Writer(World(facts), 8, mark=True)
    marks = str.maketrans("", "", "".join(MARKS))
    asked = 0
    for plain in islice(documents(facts, 8), 500):
        text = writer.document()
        assert text.translate(marks) == plain
        assert text.count(MARKS[0]) == len(writer.marks)
        asked += len(writer.marks)
    assert asked > 300
