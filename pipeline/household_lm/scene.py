"""A scene: one room with some of its objects, and the words that fill a frame's slots.

Whatever the frame, the room's name is drawn first, from one distribution: so that no sentence
has a taste in room names. Objects then follow how typical they are of that room.
"""

from __future__ import annotations

import random
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import inflect

from . import english
from .facts import Facts, Room, Thing

_LIST_LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8)
_LIST_WEIGHTS = (34, 22, 22, 9, 5, 4, 2, 2)
_SYNONYM_WEIGHT = 0.3
_THING_SYNONYM_SHARE = 0.2
_HELD_OUT_COMBINATIONS = 50  # one in so many combinations of objects is kept for judging
_OTHER_AT_MOST = 0.25  # of how typical an object is of its home
_SETTINGS = {
    "home": ("house", "apartment", "flat", "home", "villa", "cottage"),
    "office": ("office building", "company", "bank", "town hall"),
    "school": ("school", "university", "college", "kindergarten"),
    "hotel": ("hotel", "guesthouse", "inn", "resort"),
    "shop": ("shopping mall", "shopping street", "town", "village"),
    "hospital": ("hospital", "clinic", "nursing home", "health center"),
    "restaurant": ("restaurant", "hotel", "shopping mall", "pub"),
    "public": ("city", "public building", "town", "museum"),
    "industrial": ("factory", "warehouse", "company", "farm"),
}


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
            self.facts.rooms[home].objects[thing] > self.facts.rooms[
                self.rivals(thing, home)[0][0][1].name
            ].objects.get(thing, 0.0)
        )

    def draw_room(self, rng: random.Random) -> tuple[str, Room]:
        """Draw a room's name, each own name equally often."""
        return rng.choices(self.names, self.name_weights)[0]

    def draw_objects(
        self, room: Room, count: int, rng: random.Random, without: Sequence[str] = (),
        skip_held_out: bool = True,
    ) -> list[str]:
        """Draw distinct objects of a room in proportion to how typical they are."""
        weighted = {name: p for name, p in room.objects.items() if name not in without}
        chosen: list[str] = []
        while not chosen or (skip_held_out and is_held_out(chosen)):
            ranked = sorted(weighted, key=lambda name: rng.random() ** (1 / weighted[name]))
            chosen = ranked[-count:]
            rng.shuffle(chosen)
            count = max(1, count - 1)  # a short list cannot be held out for ever
        return chosen


class Scene:
    """Fills the slots of one frame, each slot with the same words wherever it recurs."""

    def __init__(
        self, world: World, rng: random.Random, room: tuple[str, Room] | None = None,
        thing: Thing | None = None, contrast: bool = False,
    ) -> None:
        self.world, self.rng, self.contrast = world, rng, contrast
        self.name, self.room = room or world.draw_room(rng)
        if thing:
            self.__dict__["thing"] = thing
            rooms, weights = zip(*world.homes[thing.name], strict=True)
            self.room = rng.choices(rooms, weights)[0]
            self.name = self.room.name
        self._filled: dict[str, str] = {}

    def fill(self, slot: str) -> str:
        """Give the words for a slot, the same each time."""
        if slot not in self._filled:
            self._filled[slot] = self._words(slot)
        return self._filled[slot]

    def _words(self, slot: str) -> str:
        if hasattr(self, f"_slot_{slot}"):
            return str(getattr(self, f"_slot_{slot}")())
        shape, _, name = slot.partition("_")
        if shape in _SHAPES and hasattr(self, f"_name_{name}"):
            return _SHAPES[shape](getattr(self, f"_name_{name}"))
        return str(getattr(self, f"_name_{slot}"))

    # Names that take an article or a plural: {room}, {a_room}, {the_room}, and so on.

    @cached_property
    def _name_room(self) -> str:
        return self.name

    @cached_property
    def _name_home(self) -> str:
        return self.name

    @cached_property
    def _name_never(self) -> str:
        return self.name

    @cached_property
    def _name_other(self) -> str:
        return self._other[0]

    @cached_property
    def _name_near(self) -> str:
        return self.rng.choice(self.room.near or (self.world.draw_room(self.rng)[0],))

    @cached_property
    def _name_synonym(self) -> str:
        names = [name for name in (self.room.name, *self.room.synonyms) if name != self.name]
        return self.rng.choice(names or [self.name])

    @cached_property
    def _name_one(self) -> str:
        return self._called(self.thing)

    @cached_property
    def _name_kind(self) -> str:
        return self.thing.kind

    # What the scene holds.

    @cached_property
    def objects(self) -> list[str]:
        """The names of the objects of ``{objects}``."""
        count = self.rng.choices(_LIST_LENGTHS, _LIST_WEIGHTS)[0]
        return self.world.draw_objects(self.room, count, self.rng)

    @cached_property
    def thing(self) -> Thing:
        """The object that ``{one}`` speaks of."""
        for _ in range(20):
            name = self.world.draw_objects(self.room, 1, self.rng)[0]
            if not self.contrast or self.world.tells_apart(name, self.room.name):
                break
        return self.world.facts.things[name]

    @cached_property
    def _other(self) -> tuple[str, Room]:
        rivals, weights = self.world.rivals(self.thing.name, self.room.name)
        return self.rng.choices(rivals, weights)[0]

    @cached_property
    def _listed(self) -> tuple[str, bool]:
        return self._list(self.objects)

    @cached_property
    def _never(self) -> str:
        return self._called(self.world.facts.things[self.rng.choice(self.room.never)])

    def _called(self, thing: Thing) -> str:
        if thing.synonyms and self.rng.random() < _THING_SYNONYM_SHARE:
            return self.rng.choice(thing.synonyms)
        return thing.name

    def _list(self, names: Sequence[str]) -> tuple[str, bool]:
        things = self.world.facts.things
        return english.noun_list([self._called(things[name]) for name in names], self.rng)

    def _more(self, room: Room, without: Sequence[str]) -> str:
        count = self.rng.choice([1, 2, 2, 3])
        return self._list(self.world.draw_objects(room, count, self.rng, without))[0]

    # Slots.

    def _slot_objects(self) -> str:
        return self._listed[0]

    def _slot_plurals(self) -> str:
        plurals = [english.plural(name) for name in self.objects]
        link = ", and " if len(plurals) > 2 else " and "
        return link.join([", ".join(plurals[:-1]), plurals[-1]] if plurals[1:] else plurals)

    def _slot_is_are(self) -> str:
        return "are" if self._listed[1] else "is"

    def _slot_them(self) -> str:
        return "them" if self._listed[1] else "it"

    def _slot_bare_list(self) -> str:
        return ", ".join(self._called(self.world.facts.things[name]) for name in self.objects)

    def _slot_more(self) -> str:
        return self._more(self.room, self.objects)

    def _slot_objects_home(self) -> str:
        return self._more(self.room, [self.thing.name])

    def _slot_objects_any(self) -> str:
        return self._more(self.world.draw_room(self.rng)[1], ())

    def _slot_other_objects(self) -> str:
        return self._more(self._other[1], [self.thing.name])

    def _slot_never_objects(self) -> str:
        return self._slot_objects()

    def _slot_one_never(self) -> str:
        return english.with_article(self._never)

    def _slot_ones_never(self) -> str:
        return english.plural(self._never)

    def _slot_rooms(self) -> str:
        return english.plural(self.name)

    def _slot_one(self) -> str:
        return english.with_article(self._name_one)

    def _slot_ones(self) -> str:
        return english.plural(self._name_one)

    def _slot_synonym_one(self) -> str:
        thing = self.thing
        names = [name for name in (thing.name, *thing.synonyms) if name != self._name_one]
        return english.with_article(self.rng.choice(names or [thing.kind]))

    def _slot_definition(self) -> str:
        return self.thing.definition

    def _slot_use(self) -> str:
        return self.thing.use

    def _slot_place(self) -> str:
        return self.rng.choice(self.thing.places or ("in the room",))

    def _slot_purpose(self) -> str:
        return self.rng.choice(self.room.purpose)

    def _slot_purpose_two(self) -> str:
        others = [text for text in self.room.purpose if text != self.fill("purpose")]
        return self.rng.choice(others or self.room.purpose)

    def _slot_description(self) -> str:
        return self.rng.choice(self.room.description)

    def _slot_setting_place(self) -> str:
        return self.rng.choice(_SETTINGS[self.room.setting])

    def _slot_a_setting_place(self) -> str:
        return english.with_article(self._slot_setting_place())

    def _slot_setting_places(self) -> str:
        return english.plural(self._slot_setting_place())

    def _slot_digit(self) -> str:
        return self.rng.choice("two three four five six seven 2 3 4 5 6 7 8 9".split())


_SHAPES = {
    "a": english.with_article,
    "the": lambda name: f"the {name}",
    "rooms": english.plural,
    "bare": str,
}
