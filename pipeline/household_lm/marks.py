"""What the generator says, between invisible marks, of the names in its text: only for training."""

from __future__ import annotations

import re
from dataclasses import dataclass

MARKS = ("\ue000", "\ue001")
MARKED = re.compile(f"{MARKS[0]}([^{MARKS[1]}]*){MARKS[1]}")


@dataclass(frozen=True)
class Evidence:
    """What a sentence has told up to here: objects of a room not yet named, or the room as well.

    It holds up to the next mark; without either, nothing is known.
    """

    told: tuple[str, ...] = ()
    room: str | None = None


@dataclass(frozen=True)
class Answer:
    """A name that is to be predicted from what stands before it.

    ``form`` is its number or article, ``told`` the objects named before. Without a ``room`` it is
    a room's name; with one it is the name of an object in that room. ``then`` is what is known
    behind it.
    """

    name: str
    form: str
    told: tuple[str, ...]
    room: str | None = None
    then: Evidence = Evidence()


Marked = Answer | Evidence


def marked(text: str) -> str:
    """A text between marks."""
    return MARKS[0] + text + MARKS[1]
