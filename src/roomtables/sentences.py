"""The sentence about objects and a room (paper equation 5), made of a template.

"A room containing o1, o2, and ok is called a(n) r." A build, which needs millions of them, lets SQL
put each together from :meth:`Template.around_room` and the room's phrase.
"""

from __future__ import annotations

import string
from collections.abc import Sequence
from dataclasses import dataclass

from roomtables.errors import ConfigError
from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.schemas import AFTER_ROOM, SENTENCE

_OBJECTS, _ROOM = "\0objects\0", "\0room\0"  # no label holds a NUL
DEFAULT_TEMPLATE = "A room containing {objects} is called {room}."


def enumerate_nouns(nouns: Sequence[str]) -> str:
    """``a``; ``a and b``; ``a, b, and c``."""
    if len(nouns) < 3:
        return " and ".join(nouns)
    return f"{', '.join(nouns[:-1])}, and {nouns[-1]}"


@dataclass(frozen=True, slots=True)
class Template:
    """A query sentence with ``{objects}`` (a list of plurals) and ``{room}`` (with its article).

    Raises
    ------
    ConfigError
        The text does not hold each placeholder exactly once, or holds another.
    """

    text: str = DEFAULT_TEMPLATE

    def __post_init__(self) -> None:
        try:
            parts = list(string.Formatter().parse(self.text))
        except ValueError:
            parts = []
        fields = sorted(name for _, name, _, _ in parts if name is not None)
        if fields != ["objects", "room"] or any(spec or conv for _, _, spec, conv in parts):
            raise ConfigError(
                f"template {self.text[:200]!r} must hold {{objects}} and {{room}} once each; "
                "correct `template` in build.toml"
            )

    def compose(self, objects: Sequence[ObjectLabel], rooms: Sequence[RoomLabel]) -> list[str]:
        """One sentence per room, all with the same objects, in the order given."""
        before, after = self.around_room(objects)
        return [before + room.phrase + after for room in rooms]

    def starts(self, rooms: Sequence[RoomLabel], scored: str) -> list[int] | None:
        """From which character on each room's sentence is scored; ``None``: the whole sentences.

        With ``scored`` as ``after_room`` that is the character behind the room's name, in a
        template that names the room first.
        """
        if scored == SENTENCE:
            return None
        before, _ = self._halves
        return [len(before) + len(room.phrase) for room in rooms]

    def around_room(self, objects: Sequence[ObjectLabel]) -> tuple[str, str]:
        """What a sentence with these objects says before its room, and after it."""
        nouns = enumerate_nouns([label.plural for label in objects])
        before, after = self._halves
        return before.replace(_OBJECTS, nouns), after.replace(_OBJECTS, nouns)

    def between_room_and_objects(self) -> str | None:
        """What stands between the room and the objects; ``None`` where the objects come first."""
        before, after = self._halves
        return None if _OBJECTS in before else after.partition(_OBJECTS)[0]

    @property
    def _halves(self) -> tuple[str, str]:
        before, _, after = self.text.format(objects=_OBJECTS, room=_ROOM).partition(_ROOM)
        return before, after


def check_templates(texts: Sequence[str], scored: str) -> None:
    """Refuse templates that make no sentences, or not those that ``scored`` needs.

    Raises
    ------
    ConfigError
        There is none, one lacks a placeholder, or two are equal; or only what stands behind the
        room is scored, and one names the room last, or puts nothing between room and objects: then
        "a bath" with "towel racks" would be one sentence with "a bath towel" and "racks".
    """
    if not texts:
        raise ConfigError("template must hold at least one sentence; correct it in build.toml")
    for number, text in enumerate(texts):
        between = Template(text).between_room_and_objects()
        if text in texts[:number]:
            raise ConfigError(
                f"template {text[:200]!r} is there twice; leave one out of build.toml"
            )
        if scored == AFTER_ROOM and not (between or "").strip():
            wrong = "names the room last" if between is None else "has no word between the two"
            raise ConfigError(
                f"template {text[:200]!r} {wrong}, but `scored` is after_room; word it like "
                "'Things that you usually find in {room}: {objects}.', or drop `scored`"
            )
