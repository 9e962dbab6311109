"""The facts arranged for drawing: a room's name first, then objects by how typical they are.

Every room's own name is drawn equally often, and a synonym at 0.3 of that, so that how often a
name is read says nothing of its room. Only where a scene starts from an object (`scene.py`) does a
room come as often as it is likely to hold that.
"""

from __future__ import annotations

import random
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from .facts import Facts, Room, Thing
from .noise import noise_words

_SYNONYM_WEIGHT = 0.3
_HELD_OUT_COMBINATIONS = 50  # one in so many combinations of objects is kept for judging
_OTHER_AT_MOST = 0.25  # of how typical an object is of its home


def is_held_out(objects: Sequence[str]) -> bool:
    """Tell whether a combination of two or more objects is kept out of the corpus."""
    key = "|".join(sorted(objects)).encode()
    return len(objects) > 1 and zlib.crc32(key) % _HELD_OUT_COMBINATIONS == 0


@dataclass(frozen=True)
class World:
    """The facts, arranged for drawing."""

    facts: Facts

    @cached_property
    def names(self) -> list[tuple[str, Room]]:
        """Every name of every room, with its room."""
        rooms = self.facts.rooms.values()
        return [(name, room) for room in rooms for name in (room.name, *room.synonyms)]

    @cached_property
    def name_weights(self) -> list[float]:
        """A room's own name counts once, a synonym less, however many there are."""
        return [1.0 if name == room.name else _SYNONYM_WEIGHT for name, room in self.names]

    @cached_property
    def homes(self) -> dict[str, list[tuple[Room, float]]]:
        """For each object the rooms that may hold it, with how typical it is there."""
        found: dict[str, list[tuple[Room, float]]] = {}
        for room in self.facts.rooms.values():
            for name, probability in room.objects.items():
                found.setdefault(name, []).append((room, probability))
        return found

    @cached_property
    def placed(self) -> list[Thing]:
        """The objects that some room holds."""
        return [thing for thing in self.facts.things.values() if thing.name in self.homes]

    @cached_property
    def noise_words(self) -> list[str]:
        """Words that tell of no room."""
        return noise_words(self.facts)

    @cached_property
    def _rivals(self) -> dict[tuple[str, str], tuple[list[tuple[str, Room]], list[float]]]:
        return {}

    def rivals(self, thing: str, home: str) -> tuple[list[tuple[str, Room]], list[float]]:
        """Give the named rooms, and their weights, where an object is rarer than at home."""
        if (thing, home) not in self._rivals:
            limit = _OTHER_AT_MOST * self.facts.rooms[home].objects[thing]
            pairs = [
                (named, weight)
                for named, weight in zip(self.names, self.name_weights, strict=True)
                if named[1].name != home and named[1].objects.get(thing, 0.0) <= limit
            ] or [(named, 1.0) for named in self.names if named[1].name != home]
            rooms, weights = zip(*pairs, strict=True)
            self._rivals[thing, home] = list(rooms), list(weights)
        return self._rivals[thing, home]

    def tells_apart(self, thing: str, home: str) -> bool:
        """Tell whether an object is much rarer in most other rooms than at home."""
        return len(self.rivals(thing, home)[0]) > len(self.names) / 2 and (
            self.facts.rooms[home].objects[thing]
            > self.facts.rooms[self.rivals(thing, home)[0][0][1].name].objects.get(thing, 0.0)
        )

    def draw_room(self, rng: random.Random) -> tuple[str, Room]:
        """Draw a room's name, each own name equally often."""
        return rng.choices(self.names, self.name_weights)[0]

    def draw_objects(
        self,
        room: Room,
        count: int,
        rng: random.Random,
        without: Sequence[str] = (),
        skip_held_out: bool = True,
        lead: Sequence[str] = (),
    ) -> list[str]:
        """Draw distinct objects of a room in proportion to how typical they are.

        Those of ``lead`` are among them, as many as ``count`` leaves room for.
        """
        out = {*without, *lead}
        weighted = {name: p for name, p in room.objects.items() if name not in out}
        chosen: list[str] = []
        while not chosen or (skip_held_out and is_held_out(chosen)):
            ranked = sorted(weighted, key=lambda name: rng.random() ** (1 / weighted[name]))
            free = count - len(lead)
            chosen = [*lead[:count], *(ranked[-free:] if free > 0 else [])]
            rng.shuffle(chosen)
            count = max(1, count - 1)  # a short list cannot be held out for ever
        return chosen
