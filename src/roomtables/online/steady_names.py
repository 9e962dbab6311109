"""Names of a running robot's rooms that do not change with every detection that comes and goes.

A room's name changes at once where the new one leads it by a margin; otherwise when the new one
has been best for some updates in a row. What an answer says of the same objects, as when the
language model answers what was decided without it, is taken at once.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from roomtables.errors import ConfigError
from roomtables.online.prediction import Prediction

DEFAULT_MARGIN = 4.0  # nats: 55 times as probable
DEFAULT_HOLD = 5  # updates
_MOST_ROOMS = 10_000  # remembered
_FORGET_AFTER = 600.0  # seconds in which a room was not seen


class NamedScene(Protocol):
    """A scene's rooms by id, and the names that they bear as it arrives."""

    @property
    def rooms(self) -> Mapping[str, Collection[str]]:
        """The labels of the objects in each room."""
        ...

    @property
    def names(self) -> Mapping[str, str]:
        """The name that each room bears."""
        ...

    @property
    def unnamed(self) -> Collection[str]:
        """The rooms that bear no name but the one that stands for their id."""
        ...

    @property
    def ours(self) -> Collection[str]:
        """The rooms that bear a name of which the scene tells that roomtables gave it."""
        ...


@dataclass(frozen=True, slots=True)
class SteadyName:
    """The name that a room gets.

    Attributes
    ----------
    label : the name; ``None`` takes away the one that roomtables gave it
    answer : of the objects that are in the room now
    """

    label: str | None
    answer: Prediction

    @property
    def held(self) -> bool:
        """Whether the name is kept although the answer is another."""
        return self.label != self.answer.room


@dataclass(slots=True)
class _Room:
    """What is remembered of a room.

    Attributes
    ----------
    label : the name it has been given
    objects : hash of the objects for which that was the answer, at last
    challenger, in_a_row : another answer, and in how many updates in a row it was that
    given : every name it has been given
    seen : when it was seen, in seconds
    """

    label: str | None = None
    objects: int = 0
    challenger: str | None = None
    in_a_row: int = 0
    given: set[str] = field(default_factory=set)
    seen: float = 0.0


class SteadyNames:
    """Decides which name each room gets, from the answers to its objects over time.

    Parameters
    ----------
    margin : nats, by which a new name must lead the present one to replace it at once: the
        difference of what the rule of the new answer compares
    hold : in how many updates in a row a new name must be best to replace it otherwise. It goes
        for rooms that no longer have an answer as well
    keep_names : leave rooms alone that bear a name which neither stands for their id nor is from
        here
    clock : seconds, from any start

    Raises
    ------
    ConfigError
        A number makes no sense.
    """

    def __init__(
        self,
        margin: float = DEFAULT_MARGIN,
        hold: int = DEFAULT_HOLD,
        keep_names: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not margin >= 0:
            raise ConfigError(f"margin must be 0 nats or more, not {margin}")
        if hold < 1:
            raise ConfigError(f"hold must be 1 update or more, not {hold}")
        self._margin, self._hold, self._keep_names = margin, hold, keep_names
        self._clock = clock
        self._rooms: OrderedDict[str, _Room] = OrderedDict()
        self.unsettled = False

    def settle(
        self, scene: NamedScene, answers: Mapping[str, Prediction], *, new: bool = True
    ) -> dict[str, SteadyName]:
        """The names to write, by room id, without the rooms that are to be left alone.

        ``new`` tells whether the scene is an update, or the last one again with newer answers.
        Afterwards ``unsettled`` says whether a name is held, which may change when the same scene
        comes again.
        """
        now, named, waiting = self._clock(), {}, 0
        for key, answer in answers.items():
            room = self._rooms.get(key) or _Room()
            ours = key in scene.ours or scene.names[key] in room.given
            if self._keep_names and not ours and key not in scene.unnamed:
                self._rooms.pop(key, None)
                continue
            room.seen = now
            self._rooms[key] = room
            self._rooms.move_to_end(key)
            self._update(room, answer, hash(frozenset(scene.rooms[key])), new)
            waiting += room.in_a_row > 0
            if room.label is not None or ours:
                named[key] = SteadyName(room.label, answer)
        self._forget(now)
        self.unsettled = waiting > 0
        return named

    def _update(self, room: _Room, answer: Prediction, objects: int, new: bool) -> None:
        """Let a room have the answer's name, or hold the one it has."""
        if answer.room == room.label:
            room.in_a_row = 0
        else:
            same = room.in_a_row > 0 and room.challenger == answer.room
            room.in_a_row = room.in_a_row + new if same else 1
            room.challenger = answer.room
            if not (
                room.label is None
                or room.objects == objects
                or room.in_a_row >= self._hold
                or _lead(answer, room.label) >= self._margin
            ):
                return
            room.label, room.in_a_row = answer.room, 0
        room.objects = objects
        if room.label is not None:
            room.given.add(room.label)

    def _forget(self, now: float) -> None:
        """Forget rooms that were not seen for long, and the oldest where there are too many."""
        while self._rooms:
            key, room = next(iter(self._rooms.items()))
            if now - room.seen <= _FORGET_AFTER and len(self._rooms) <= _MOST_ROOMS:
                return
            del self._rooms[key]


def _lead(answer: Prediction, label: str) -> float:
    """By how many nats the answer leads a room, in what its rule compares; −inf without answer."""
    if answer.room is None or answer.compared is None:
        return -float("inf")
    compared = dict(zip(answer.decider.candidates.names, answer.compared.tolist(), strict=True))
    return float(compared[answer.room] - compared.get(label, -float("inf")))
