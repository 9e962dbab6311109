"""A scene: one room with some of its objects, and the words that fill a frame's slots.

A name that follows from the objects (or the room) named before it can be marked as an answer.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from . import english
from .facts import SYNONYM_SHARE, Room, Thing
from .world import World

_LIST_LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8)
_LIST_WEIGHTS = (34, 22, 22, 9, 5, 4, 2, 2)
MARKS = ("\ue000", "\ue001")  # around an answer, in text that is only for training
_ROOM_SLOTS = frozenset(["room", "a_room", "the_room", "rooms", "home", "a_home", "the_home"])
_THING_SLOTS = frozenset(
    ["one", "ones", "the_one", "bare_one", "definition", "kind", "a_kind", "use", "place"]
)
_NAMING_SLOTS = frozenset(["objects", "plurals", "bare_list"])
_LIST_SLOTS = _NAMING_SLOTS | {"is_are", "them", "more", "digit"}
_DIGITS = ("two", "three", "four", "five", "six", "seven", *"23456789")
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


@dataclass(frozen=True)
class Answer:
    """A name that is to be predicted from what stands before it.

    ``form`` is its number or article, ``told`` the objects named before. Without a ``room`` it is
    a room's name; with one it is the name of an object in that room.
    """

    name: str
    form: str
    told: tuple[str, ...]
    room: str | None = None


class Scene:
    """Fills the slots of one frame, each slot with the same words wherever it recurs."""

    def __init__(
        self,
        world: World,
        rng: random.Random,
        room: tuple[str, Room] | None = None,
        thing: Thing | None = None,
        contrast: bool = False,
        answers: list[Answer] | None = None,
    ) -> None:
        self.world, self.rng, self.contrast, self.answers = world, rng, contrast, answers
        self.name, self.room = room or world.draw_room(rng)
        if thing:
            self.__dict__["thing"] = thing
            rooms, weights = zip(*world.homes[thing.name], strict=True)
            self.room = rng.choices(rooms, weights)[0]
            self.name = self.room.name
        self._filled: dict[str, str] = {}
        self._further: list[str] = []

    def fill(self, slot: str) -> str:
        """Give the words for a slot, the same each time; mark a room's name that is an answer."""
        if slot in self._filled:
            return self._filled[slot]
        told = self._told(slot)
        words = self._filled[slot] = self._words(slot)
        if not told or self.answers is None:
            return words
        form = "plural" if slot.startswith("rooms") else slot.partition("_")[0]
        self.answers.append(Answer(self.name, form, told))
        name = words if form == "plural" else self.name
        return words.removesuffix(name) + MARKS[0] + name + MARKS[1]

    def _told(self, slot: str) -> tuple[str, ...]:
        """Objects told before a room's first mention, when nothing else gives it away."""
        names = slot in _ROOM_SLOTS and self.answers is not None and not self.contrast
        if not names or not self._filled.keys() <= (_THING_SLOTS | _LIST_SLOTS):
            return ()
        told = [*self.objects] if self._filled.keys() & _NAMING_SLOTS else []
        told += self._further
        return (*told, self.thing.name) if self._filled.keys() & _THING_SLOTS else tuple(told)

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
        told = [self.thing.name] if self._filled.keys() & _THING_SLOTS else []
        return self._list(self.objects, told, self._knows_room())

    @cached_property
    def _never(self) -> str:
        return self._called(self.world.facts.things[self.rng.choice(self.room.never)])

    def _called(self, thing: Thing) -> str:
        if thing.synonyms and self.rng.random() < SYNONYM_SHARE:
            return self.rng.choice(thing.synonyms)
        return thing.name

    def _list(
        self, names: Sequence[str], told: Sequence[str] = (), known: bool = False
    ) -> tuple[str, bool]:
        """List objects; where the room is ``known``, each is an answer."""
        called = [self._called(self.world.facts.things[name]) for name in names]

        def mark(index: int, form: str, noun: str) -> str:
            if self.answers is None or not known or not form:
                return noun
            before = (*told, *names[:index])
            self.answers.append(Answer(called[index], form, before, self.room.name))
            return MARKS[0] + noun + MARKS[1]

        return english.noun_list(called, self.rng, mark)

    def _knows_room(self) -> bool:
        return not self.contrast and bool(self._filled.keys() & _ROOM_SLOTS)

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
        self._further = self.world.draw_objects(
            self.room, self.rng.choice([1, 2, 2, 3]), self.rng, self.objects
        )
        return self._list(self._further, self.objects, self._knows_room())[0]

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
        return str(self.rng.choice(_DIGITS))


_SHAPES: dict[str, Callable[[str], str]] = {
    "a": english.with_article,
    "the": lambda name: f"the {name}",
    "rooms": english.plural,
    "bare": str,
}
