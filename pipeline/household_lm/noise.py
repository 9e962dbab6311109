"""Noise in a frame's own words, so that a model learns to go by the objects in any sentence.

Some words of a frame go, others give way to one or several that say nothing of the room: words of
other frames, words of the prose in the knowledge, and words that mean nothing.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator

from . import english
from .facts import Facts
from .grammar import FRAMES, load_frames, own_words

_SHARES = (0.15, 0.35, 0.6, 1.0)  # of a sentence's own words that change
_LENGTHS = (0, 1, 1, 1, 2, 3)  # words in place of one
_MADE_UP_SHARE = 0.3  # of those words
# The query's sentence is never written: these in no noise, those in no sentence with one another.
_ROOM = {"room", "rooms"}
_OF_THE_QUERY = {"containing", "called"}
_HELD_OUT = "held_out"
_ONSETS = "b c d f g h j k l m n p r s t v w z bl br ch cl cr dr fl gr pl pr sh sl sp st str th tr"
_CODAS = "b d g l m n p r s t x y ck ds ed er ing ll ly nd ng ns nt rd rs st"


def noise(words: list[str], own: set[str], rng: random.Random) -> Callable[[str], str]:
    """Choose how much of a sentence changes, whose frame has ``own`` words.

    The result changes each part of it.
    """
    share = rng.choice(_SHARES)
    spared = _OF_THE_QUERY - (own & _OF_THE_QUERY or {rng.choice(sorted(_OF_THE_QUERY))})

    def word() -> str:
        found = made_up(rng) if rng.random() < _MADE_UP_SHARE else rng.choice(words)
        return word() if found in spared else found

    def changed(match: re.Match[str]) -> str:
        if rng.random() >= share:
            return match.group()
        found = [word() for _ in range(rng.choice(_LENGTHS))]
        return " ".join(found) + " " * (bool(found) and match.group().endswith(" "))

    return lambda text: re.sub(r"[A-Za-z]+ ?", changed, text)


def noise_words(facts: Facts) -> list[str]:
    """Give the words of the frames and of the knowledge's prose that tell of no room.

    Without the words of any name in the prose, and without "room", lest the query's sentence be
    written.
    """
    of_frames: set[str] = set()
    for path in FRAMES.glob("*.txt"):
        if path.stem != _HELD_OUT:
            of_frames.update(*(own_words(frame) for frame in load_frames(path.stem)))
    of_prose = {word for text in _prose(facts) for word in re.findall(r"[a-z]+", text)}
    of_names = {word for name in _names(facts) for word in name.split()}
    found = of_frames | _OF_THE_QUERY | of_prose - of_names
    return sorted(word for word in found if word.lower() not in _ROOM)


def _prose(facts: Facts) -> Iterator[str]:
    for room in facts.rooms.values():
        yield from (*room.purpose, *room.description)
    for thing in facts.things.values():
        yield from (thing.definition, thing.use)


def _names(facts: Facts) -> Iterator[str]:
    for room in facts.rooms.values():
        yield from (room.name, *room.synonyms)
    for thing in facts.things.values():
        for name, _ in thing.called():
            yield from (name, english.plural(name))


def made_up(rng: random.Random) -> str:
    """A word that means nothing, of one to three syllables."""
    onsets, codas = ["", *_ONSETS.split()], ["", *_CODAS.split()]
    syllables = (rng.choice(onsets) + rng.choice("aeiou") for _ in range(rng.randint(1, 3)))
    return "".join(syllables) + rng.choice(codas)
