"""The corpus of household-lm: it lacks the query sentence, and its seed determines it."""

from __future__ import annotations

import random
import re
from collections import Counter
from itertools import islice

import pytest
from pipeline.household_lm import check_knowledge
from pipeline.household_lm.facts import Facts, load_facts
from pipeline.household_lm.generate import KINDS, documents
from pipeline.household_lm.grammar import FRAMES, load_frames, parse, read_lines, render
from pipeline.household_lm.noise import made_up, noise, noise_words
from pipeline.household_lm.scene import Scene
from pipeline.household_lm.world import World, is_held_out

TRAINED_KINDS = [*KINDS, "walks", "walk_openings"]


@pytest.fixture(scope="module")
def facts() -> Facts:
    return load_facts()


@pytest.fixture(scope="module")
def sample(facts: Facts) -> list[str]:
    return list(islice(documents(facts, seed=77), 2_500))


def test_the_knowledge_has_no_problems(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_knowledge.main() == 0, capsys.readouterr().out


def test_the_query_frame_is_not_in_the_corpus(sample: list[str]) -> None:
    text = "\n".join(sample).lower()
    assert "room containing" not in text
    for sentence in re.split(r"[.?!\n]", text):
        assert not re.search(r"containing.*(is|are) (usually )?called", sentence), sentence


def test_the_query_frame_is_in_no_file_of_frames() -> None:
    for path in FRAMES.glob("*.txt"):
        for line in read_lines(path):
            assert not re.search(r"(room|rooms|\{room\}|_room\})\W.{0,40}containing", line), line
            assert not ("containing" in line and "called" in line), line


def test_noise_cannot_make_the_query_frame(facts: Facts) -> None:
    words = noise_words(facts)
    assert len(words) > 1_000
    assert not {"room", "rooms"} & {word.lower() for word in words}
    rng, query = random.Random(2), {"containing", "called"}
    for own in (set(), {"containing"}, {"called"}):
        for _ in range(500):
            made = set(noise([*query], own, rng)("one two three four").split())
            assert not query <= own | made


def test_the_prose_lends_noise_no_name(facts: Facts) -> None:
    words = set(noise_words(facts))
    assert "sweep" in words  # "sweep the floor"
    assert "refrigerator" not in words  # from the definition of another object
    assert "bathroom" not in words


def test_noise_changes_lengthens_and_shortens_a_frame(facts: Facts) -> None:
    rng, words, text = random.Random(1), noise_words(facts), "  where they keep, say, no  "
    made = [noise(words, set(), rng)(text) for _ in range(300)]
    lengths = {len(noisy.split()) for noisy in made}
    assert min(lengths) < 5 < max(lengths)
    assert sum(noisy == text for noisy in made) < 150
    # What is no word of a frame stays: stops, and the space before a slot.
    assert all(noisy.count(",") == 2 and noisy.startswith("  ") for noisy in made)
    assert all(noisy.endswith(" ") for noisy in made)


def test_noise_is_drawn_from_its_seed(facts: Facts) -> None:
    words = noise_words(facts)
    first, again = (noise(words, set(), random.Random(9))("one two three four") for _ in range(2))
    assert first == again
    assert len({made_up(random.Random(seed)) for seed in range(50)}) > 40


def test_the_words_of_the_query_frame_occur_elsewhere(sample: list[str]) -> None:
    text = "\n".join(sample)
    for words in (" containing ", "is called ", "A room "):
        assert text.count(words) >= 5, words


def test_the_same_seed_writes_the_same_text(facts: Facts) -> None:
    first, again, other = (list(islice(documents(facts, seed), 300)) for seed in (4, 4, 5))
    assert first == again
    assert first != other


def test_there_are_hundreds_of_frames_and_none_twice() -> None:
    lines = [line for kind in KINDS for line in read_lines(FRAMES / f"{kind}.txt")]
    assert len(lines) >= 300
    assert max(Counter(lines).values()) == 1


@pytest.mark.parametrize("kind", [*TRAINED_KINDS, "held_out"])
def test_every_slot_of_every_frame_can_be_filled(facts: Facts, kind: str) -> None:
    rng, world = random.Random(3), World(facts)
    for frame in load_frames(kind):
        for _ in range(4):
            text = render(frame, Scene(world, rng).fill, rng)
            assert not re.search(r"[{}|\[\]]|  | [,.;:?!]", text), text


def test_a_frame_that_does_not_close_is_refused() -> None:
    for text in ("a [b|c", "a {b", "a ] b"):
        with pytest.raises(ValueError, match="frame"):
            parse(text)


def test_every_room_is_as_likely_as_another(facts: Facts) -> None:
    world, rng = World(facts), random.Random(1)
    drawn = Counter(world.draw_room(rng)[0] for _ in range(400 * len(facts.rooms)))
    own = [drawn[name] for name in facts.rooms]
    assert max(own) < 1.5 * min(own)
    synonyms = [drawn[name] for name, room in world.names if name != room.name]
    assert max(synonyms) < min(own)


def test_objects_are_drawn_by_how_typical_they_are(facts: Facts) -> None:
    world, rng = World(facts), random.Random(2)
    room = facts.rooms["bathroom"]
    drawn = Counter(world.draw_objects(room, 1, rng)[0] for _ in range(15_000))
    total = sum(room.objects.values())
    for name, typical in room.objects.items():
        expected = 15_000 * typical / total
        assert abs(drawn[name] - expected) < 6 * expected**0.5 + 1, name


def test_held_out_combinations_and_frames_stay_out(facts: Facts, sample: list[str]) -> None:
    world, rng = World(facts), random.Random(5)
    for name, room in islice(world.names, 150):
        assert not is_held_out(Scene(world, rng, (name, room)).objects)
    text = "\n".join(sample)
    for line in read_lines(FRAMES / "held_out.txt"):
        literal = max(re.split(r"\{\w+\}", line), key=len).strip(" .,")
        assert literal not in text
