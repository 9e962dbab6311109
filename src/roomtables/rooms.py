"""A room as every part of roomtables sees it, and the JSON lines that carry rooms in.

One line is ``{"room_id": …, "room"?: …, "objects": […]}``; ``room`` is the ground truth, a label or
several (a list, or ``a;b``), any of which is right.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roomtables.errors import InputError


@dataclass(frozen=True, slots=True)
class Room:
    """One room: its id, the labels of the objects in it, and the true room labels where known."""

    room_id: str
    objects: tuple[str, ...]
    truth: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The room as a room line; ``room`` only where the truth is known."""
        truth = {"room": ";".join(self.truth)} if self.truth else {}
        return {"room_id": self.room_id, **truth, "objects": list(self.objects)}


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
    return Room(str(room_id), tuple(objects), _truth(value.get("room"), where))


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
    for number, line in enumerate(lines, start=1):
        where = f"{source}, line {number}"
        try:
            text = line.decode("utf-8") if isinstance(line, bytes) else line
            if not text.strip():
                continue
            value = json.loads(text.lstrip("\ufeff"))
        except UnicodeDecodeError as error:
            raise InputError(f"{where}: not UTF-8 text ({error.reason})") from error
        except (ValueError, RecursionError) as error:  # also a number of thousands of digits
            raise InputError(f"{where}: invalid JSON ({error})") from error
        yield parse_room(value, where)


def read_room_lines(path: Path) -> Iterator[Room]:
    """Rooms from a JSON lines file, lazily.

    Raises
    ------
    InputError
        The file cannot be read, or a line is malformed.
    """
    try:
        with path.open("rb") as lines:
            yield from parse_room_lines(lines, str(path))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}; give a file of room lines"
        ) from error
