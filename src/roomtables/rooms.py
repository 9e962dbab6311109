"""A room, as every part of roomtables takes it, and JSON lines of rooms.

One line is ``{"room_id": …, "room"?: …, "objects": […]}``; ``room`` is the ground truth, a label or
several (a list, or ``a;b``), any of which is right. Beside ``objects`` a line may carry
``counts`` or ``confidences``, lists of one number per object.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.limits import NAME_CHARACTERS, MalformedError, json_value, text_lines

COUNTS = "counts"
CONFIDENCES = "confidences"
MEASURES = (COUNTS, CONFIDENCES)


@dataclass(frozen=True, slots=True)
class Room:
    """One room: its id, the labels of the objects in it, and the true room labels where known.

    ``measures`` holds the line's ``counts`` and ``confidences`` as they stand there, one entry per
    object; :meth:`measured` checks them.
    """

    room_id: str
    objects: tuple[str, ...]
    truth: tuple[str, ...] = ()
    measures: Mapping[str, tuple[Any, ...]] = field(default_factory=dict, hash=False)

    def measured(self, name: str) -> tuple[float, ...]:
        """``counts`` or ``confidences``, one per object; all 1 where the room has none.

        Raises
        ------
        InputError
            They are not as many as the objects, or one is not a number from 0 (to 1).
        """
        values = self.measures.get(name, (1.0,) * len(self.objects))
        highest = 1.0 if name == CONFIDENCES else sys.float_info.max
        if len(values) != len(self.objects) or not all(
            isinstance(v, int | float) and not isinstance(v, bool) and 0 <= v <= highest
            for v in values
        ):
            upper = " and at most 1" if name == CONFIDENCES else ""
            raise InputError(
                f"room {self.room_id!r}: `{name}` must be a list with one number of 0 or more"
                f"{upper} per object"
            )
        return tuple(map(float, values))

    def as_json(self) -> dict[str, Any]:
        """The room as a room line; ``room`` only where the truth is known."""
        truth = {"room": ";".join(self.truth)} if self.truth else {}
        measures = {name: list(values) for name, values in self.measures.items()}
        return {"room_id": self.room_id, **truth, "objects": list(self.objects), **measures}


def parse_room(value: object, where: str) -> Room:
    """A room from a decoded room line; ``where`` names file and line in the error.

    Raises
    ------
    InputError
        The value is not an object, or a key is missing or of the wrong type.
    """
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected a JSON object with room_id and objects")
    room_id = value.get("room_id")
    if isinstance(room_id, bool) or not isinstance(room_id, str | int):
        raise InputError(f"{where}: `room_id` must be a string")
    objects = value.get("objects")
    if not isinstance(objects, list) or not all(isinstance(name, str) for name in objects):
        raise InputError(f"{where}: `objects` must be a list of strings")
    if max(map(len, (str(room_id), *objects))) > NAME_CHARACTERS:
        raise InputError(f"{where}: a name of more than {NAME_CHARACTERS} characters")
    measures = {n: tuple(v) for n in MEASURES if isinstance(v := value.get(n), list)}
    return Room(str(room_id), tuple(objects), _truth(value.get("room"), where), measures)


def _truth(value: object, where: str) -> tuple[str, ...]:
    if value is None:
        return ()
    labels = value.split(";") if isinstance(value, str) else value
    if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
        raise InputError(f"{where}: `room` must be a string or a list of strings")
    return tuple(label.strip() for label in labels if label.strip())


def parse_room_lines(lines: Iterable[str | bytes], source: str) -> Iterator[Room]:
    """Rooms from JSON lines, lazily; empty lines are skipped.

    Raises
    ------
    InputError
        A line is not UTF-8, not valid JSON, or not a room; the message names ``source`` and line.
    """
    number = 1
    try:
        for line in lines:
            if line.strip():
                yield parse_room(json_value(line), f"{source}, line {number}")
            number += 1
    except MalformedError as error:
        raise InputError(f"{source}, line {number}: {error}") from error


def read_room_lines(path: Path) -> Iterator[Room]:
    """Rooms from a JSON lines file, lazily.

    Raises
    ------
    InputError
        The file cannot be read, or a line is malformed.
    """
    try:
        with path.open("rb") as lines:
            yield from parse_room_lines(text_lines(lines), str(path))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}; give a file of room lines"
        ) from error
