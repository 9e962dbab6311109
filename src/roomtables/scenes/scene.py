"""A scene as every reader yields it: rooms that hold objects, and the objects that no room holds.

Positions and boxes are in metres, in the scene's own frame, and are left out where a format has
none, as room lists.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from roomtables.rooms import Room

Point = tuple[float, float, float]
Warn = Callable[[str], None]


def are_finite(*values: object) -> bool:
    """Whether all are finite numbers; an integer beyond a float's range is not."""
    try:
        return all(isinstance(value, int | float) and math.isfinite(value) for value in values)
    except OverflowError:
        return False


def as_point(value: object) -> Point | None:
    """A decoded JSON value as a point; None where it is not three finite numbers."""
    match value:
        case [int() | float() as x, int() | float() as y, int() | float() as z] if are_finite(
            x, y, z
        ):
            return (float(x), float(y), float(z))
        case _:
            return None


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box, in metres; empty where a ``low`` exceeds its ``high``."""

    low: Point
    high: Point

    def contains(self, point: Point) -> bool:
        """Whether the point lies inside, walls included."""
        return all(a <= x <= b for a, x, b in zip(self.low, point, self.high, strict=True))

    @property
    def volume(self) -> float:
        """Cubic metres; 0 for an empty box."""
        return math.prod(max(b - a, 0.0) for a, b in zip(self.low, self.high, strict=True))


@dataclass(frozen=True, slots=True)
class SceneObject:
    """One object: its id in the scene, its label, and where it is, where that is known."""

    object_id: str
    name: str
    position: Point | None = None
    box: Box | None = None

    def as_json(self) -> dict[str, Any]:
        """The object as an entry of nested JSON."""
        where = {"position": list(self.position)} if self.position else {}
        return {"id": self.object_id, "name": self.name, **where}


@dataclass(frozen=True, slots=True)
class SceneRoom:
    """One room: its id and name in the scene, its objects, its true labels where known.

    ``position`` is where the scene puts the room itself, in metres. ``measures`` is as in
    :class:`~roomtables.rooms.Room`.
    """

    room_id: str
    objects: tuple[SceneObject, ...]
    name: str = ""
    truth: tuple[str, ...] = ()
    box: Box | None = None
    position: Point | None = None
    measures: Mapping[str, tuple[Any, ...]] = field(default_factory=dict, hash=False)

    def as_room(self) -> Room:
        """The room as every other part of roomtables sees it."""
        names = tuple(thing.name for thing in self.objects)
        return Room(self.room_id, names, self.truth, self.measures)

    def as_json(self) -> dict[str, Any]:
        """The room as an entry of nested JSON; ``room`` only where the truth is known."""
        truth = {"room": ";".join(self.truth)} if self.truth else {}
        name = ";".join(self.truth) or self.name or self.room_id
        objects = [thing.as_json() for thing in self.objects]
        return {"id": self.room_id, "name": name, **truth, "objects": objects}


@dataclass(frozen=True, slots=True)
class Scene:
    """One scene. ``rooms`` may be an iterator, to be run through once (a long room list).

    ``local_ids`` says that another scene may use the same room ids, as graphs do (``R0``).
    """

    name: str
    rooms: Iterable[SceneRoom]
    unassigned: tuple[SceneObject, ...] = ()
    local_ids: bool = False


def silent(_: str) -> None:
    """Drop a warning."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How to read a scene; a reader looks at the fields that concern its format.

    ``labelspace`` is a Hydra label-space YAML for a graph that names no labels; ``keep_all`` keeps
    the Matterport rooms that the paper drops; ``object_labels`` is ``mpcat40`` or ``nyuclass``;
    ``category_mapping`` is Matterport's own ``category_mapping.tsv``; ``warn`` receives a line
    about each thing that was left out.
    """

    labelspace: Path | None = None
    keep_all: bool = False
    object_labels: str = "mpcat40"
    category_mapping: Path | None = None
    warn: Warn = field(default=silent)


def report_unassigned(scene: Scene, total: int, warn: Warn) -> None:
    """Tell how many of the scene's ``total`` objects lie in no room, and name the first few."""
    if not scene.unassigned:
        return
    shown = ", ".join(f"{thing.object_id} ({thing.name})" for thing in scene.unassigned[:5])
    more = ", …" if len(scene.unassigned) > 5 else ""
    lie = "lies" if len(scene.unassigned) == 1 else "lie"
    warn(
        f"{scene.name}: {len(scene.unassigned)} of {total} objects {lie} in no room: {shown}{more}"
    )


def room_frequencies(rooms: Iterable[SceneRoom]) -> Counter[str]:
    """How many rooms have each true label; ``unknown`` where a room has none."""
    return Counter(";".join(room.truth) or "unknown" for room in rooms)
