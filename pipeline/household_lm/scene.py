"""A scene: one room with some of its objects, and the words that fill a frame's slots.

A name that follows from the objects (or the room) named before it can be marked as an answer, and
what is known after a name as evidence.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import cached_property

from . import english
from .facts import SETTINGS, SYNONYM_SHARE, Room, Thing
from .marks import Answer, Evidence, Marked, marked
from .world import World

_LIST_LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8)
_LIST_WEIGHTS = (34, 22, 22, 9, 5, 4, 2, 2)
_STRAY_SHARE = 0.15  # of lists that tell of a room hold one object that may not belong there
_ROOM_SLOTS = frozenset(["room", "a_room", "the_room", "rooms", "home", "a_home", "the_home"])
_CALLING_SLOTS = frozenset(["one", "ones", "the_one", "bare_one"])
_THING_SLOTS = _CALLING_SLOTS | {"definition", "kind", "a_kind", "use", "place"}
_NAMING_SLOTS = frozenset(["objects", "plurals", "bare_list"])
_LIST_SLOTS = _NAMING_SLOTS | {"is_are", "them", "more", "digit"}
_DIGITS = ("two", "three", "four", "five", "six", "seven", *"23456789")
MarkObject = Callable[[Sequence[str], str, str, str], str]


class Scene:
    """Fills the slots of one frame, each slot with the same words wherever it recurs."""

    def __init__(
        self,
        world: World,
        rng: random.Random,
        room: tuple[str, Room] | None = None,
        thing: Thing | None = None,
        contrast: bool = False,
        marks: list[Marked] | None = None,
    ) -> None:
        self.world, self.rng, self.contrast, self.marks = world, rng, contrast, marks
        self._lead = thing.name if thing else None
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
        told = self._told() if slot in _ROOM_SLOTS else ()
        words = self._filled[slot] = self._words(slot)
        if self.marks is None or self.contrast:
            return words
        known = self._knows_room()
        if slot in _CALLING_SLOTS and (known or self._tells_objects_only()):
            self.marks.append(Evidence(self._mentioned(), self.room.name if known else None))
            return marked(words)
        if slot not in _ROOM_SLOTS:
            return words
        form = "plural" if slot.startswith("rooms") else slot.partition("_")[0]
        name = words if form == "plural" else self.name
        then = Evidence(self._mentioned(), self.room.name)
        self.marks.append(Answer(self.name, form, told, then=then) if told else then)
        return words.removesuffix(name) + marked(name)

    def _tells_objects_only(self) -> bool:
        """Tell whether nothing but objects gives the room away so far."""
        return not self.contrast and self._filled.keys() <= (_THING_SLOTS | _LIST_SLOTS)

    def _told(self) -> tuple[str, ...]:
        """Objects told before a room's first mention, when nothing else gives it away."""
        return self._mentioned() if self._tells_objects_only() else ()

    def _mentioned(self) -> tuple[str, ...]:
        """The objects of the room that slots have spoken of."""
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
        told = self.contrast or self._knows_room()
        stray = count > 1 and self.rng.random() < _STRAY_SHARE and not told
        lead = [self._lead] if self._lead else []
        lead += [self.rng.choice(self.world.placed).name] if stray else []
        return self.world.draw_objects(self.room, count, self.rng, lead=[*dict.fromkeys(lead)])

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
        return self._list(self.objects, self._mark_object)

    @cached_property
    def _never(self) -> str:
        return self._called(self.world.facts.things[self.rng.choice(self.room.never)])

    def _called(self, thing: Thing) -> str:
        if thing.synonyms and self.rng.random() < SYNONYM_SHARE:
            return self.rng.choice(thing.synonyms)
        return thing.name

    def _list(self, names: Sequence[str], mark: MarkObject | None = None) -> tuple[str, bool]:
        """List objects; ``mark`` may put marks around each."""
        called = [self._called(self.world.facts.things[name]) for name in names]

        def marked_noun(index: int, form: str, noun: str) -> str:
            return mark(names[: index + 1], called[index], form, noun) if mark else noun

        return english.noun_list(called, self.rng, marked_noun)

    def _mark_object(self, names: Sequence[str], called: str, form: str, noun: str) -> str:
        """Mark a room's object: an answer where the room is known, else evidence of the room.

        ``names`` are the objects of its list up to it.
        """
        known = self._knows_room()
        if self.marks is None or not (known or self._tells_objects_only()):
            return noun
        told = (*self._mentioned(), *names)
        then = Evidence(told, self.room.name if known else None)
        answers = known and form
        self.marks.append(Answer(called, form, told[:-1], then.room, then) if answers else then)
        return marked(noun)

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
        called = [self._called(self.world.facts.things[name]) for name in self.objects]
        return ", ".join(
            self._mark_object(self.objects[: index + 1], name, "bare", name)
            for index, name in enumerate(called)
        )

    def _slot_more(self) -> str:
        count = self.rng.choice([1, 2, 2, 3])
        further = self.world.draw_objects(self.room, count, self.rng, self._mentioned())
        words = self._list(further, self._mark_object)[0]
        self._further = further
        return words

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
        return self.rng.choice(SETTINGS[self.room.setting])

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
