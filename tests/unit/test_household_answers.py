"""What a room's name should be, given the objects told: Bayes' rule, worked by hand."""

from __future__ import annotations

from itertools import islice

import pytest

pytest.importorskip("tokenizers")

from pipeline.household_lm.answers import Posterior
from pipeline.household_lm.facts import Facts, Room, Thing, load_facts
from pipeline.household_lm.generate import Writer, documents
from pipeline.household_lm.packing import train_tokenizer
from pipeline.household_lm.scene import MARKS, Answer
from pipeline.household_lm.world import World


def _room(name: str, synonyms: tuple[str, ...], objects: dict[str, float]) -> Room:
    return Room(name, synonyms, "home", ("rest",), ("quiet",), (), objects, ("moon",))


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    things = [Thing(n, "thing", f"a {n}", "see", ("there",), ()) for n in ("lamp", "bed", "moon")]
    rooms = [
        _room("kitchen", (), {"lamp": 0.5}),
        _room("bedroom", ("chamber",), {"lamp": 0.5, "bed": 0.5}),
        _room("office", (), {"lamp": 0.9, "bed": 0.1}),
    ]
    world = World(Facts({r.name: r for r in rooms}, {t.name: t for t in things}))
    return Posterior(world, train_tokenizer(load_facts(), 3000, count=2000))


def _by_name(posterior: Posterior, marked: str, answer: Answer) -> dict[str, float]:
    _, [(_, tokens, shares)] = posterior.targets(marked, [answer])
    words = [posterior.tokenizer.decode([int(token)]).strip() for token in tokens]
    return dict(zip(words, shares.tolist(), strict=True))


def test_the_answer_is_bayes_rule_over_names(posterior: Posterior) -> None:
    marked = f"Lamps are in the {MARKS[0]}bedroom{MARKS[1]}."
    found = _by_name(posterior, marked, Answer("bedroom", "the", ("lamp",)))
    # p(lamp | room) is 1, 1/2 and 9/10; "chamber" weighs 0.3 beside the bedroom's own name.
    total = 1 + 0.5 + 0.5 * 0.3 + 0.9
    assert found["kitchen"] == pytest.approx(1 / total, rel=1e-5)
    assert found["bedroom"] == pytest.approx(0.5 / total, rel=1e-5)
    assert found["office"] == pytest.approx(0.9 / total, rel=1e-5)
    assert sum(found.values()) == pytest.approx(1)


def test_two_objects_multiply(posterior: Posterior) -> None:
    marked = f"Lamps and beds are in the {MARKS[0]}bedroom{MARKS[1]}."
    found = _by_name(posterior, marked, Answer("bedroom", "the", ("lamp", "bed")))
    assert found["bedroom"] / found["office"] == pytest.approx(0.25 / 0.09, rel=1e-5)
    unnamed = 0.004 / 0.5  # no kitchen file names a bed: rare there, not impossible
    assert found["kitchen"] / found["bedroom"] == pytest.approx(unnamed / 0.25, rel=1e-5)


def test_an_article_that_is_written_rules_names_out(posterior: Posterior) -> None:
    marked = f"Lamps: an {MARKS[0]}office{MARKS[1]}."
    found = _by_name(posterior, marked, Answer("office", "a", ("lamp",)))
    assert found["office"] == pytest.approx(1)
    assert found["kitchen"] == 0


def test_the_answer_stands_where_the_name_does(posterior: Posterior) -> None:
    marked = f"A lamp, so it is the {MARKS[0]}bedroom{MARKS[1]}."
    ids, [(place, _, _)] = posterior.targets(marked, [Answer("bedroom", "the", ("lamp",))])
    assert posterior.tokenizer.decode(ids[place:]).strip() == "bedroom."


def test_marks_change_nothing_else() -> None:
    facts = load_facts()
    writer = Writer(World(facts), 8, mark=True)
    marks = str.maketrans("", "", "".join(MARKS))
    asked = 0
    for plain in islice(documents(facts, 8), 500):
        marked = writer.document()
        assert marked.translate(marks) == plain
        assert marked.count(MARKS[0]) == len(writer.answers)
        asked += len(writer.answers)
    assert asked > 300
