"""Small values of a Spark-DSG node: its symbol, its position, its box."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from roomtables.errors import InputError
from roomtables.scenes.scene import Box, Point, are_finite, as_point

_INVALID_BOXES = ("INVALID", 0)


def symbol(node: int) -> str:
    """A node's id as Spark-DSG prints it: a letter and an index, ``R0``."""
    letter = chr(node >> 56)
    plain = letter.isascii() and letter.isalpha()
    return f"{letter}{node & (2**56 - 1)}" if plain else str(node)


def node_point(attributes: Mapping[str, Any], where: str) -> Point | None:
    """The node's position in metres; None where it has none.

    Raises
    ------
    InputError
        It is not three finite numbers.
    """
    if attributes.get("position") is None:
        return None
    return _point(attributes["position"], f"{where}: position")


def node_box(attributes: Mapping[str, Any], where: str) -> Box | None:
    """The node's axis-aligned box in metres, around an oriented one where it is that.

    None where the graph marks it invalid, gives none, or it has no extent.

    Raises
    ------
    InputError
        It holds what is not a finite number (JSON writes NaN as null).
    """
    match attributes.get("bounding_box"):
        case {"type": kind} if kind in _INVALID_BOXES:
            return None
        case {"min": low, "max": high}:
            box = Box(_point(low, f"{where}: box"), _point(high, f"{where}: box"))
        case {"dimensions": size, "world_P_center": centre, **rest}:
            middle = _point(centre, f"{where}: box")
            half = _turned(_point(size, f"{where}: box"), rest.get("world_R_center"), where)
            box = _around(middle, half)
        case _:
            return None
    return box if box.low != box.high else None


def _around(middle: Point, half: Point) -> Box:
    low, high = (
        (middle[0] + sign * half[0], middle[1] + sign * half[1], middle[2] + sign * half[2])
        for sign in (-1, 1)
    )
    return Box(low, high)


def _turned(size: Point, rotation: object, where: str) -> Point:
    """Half the extent, along the world's axes, of a box of this size turned by a quaternion."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    match rotation:
        case {"w": w, "x": x, "y": y, "z": z}:
            if not are_finite(w, x, y, z):
                raise InputError(f"{where}: box rotation is not finite; save the graph again")
        case _:
            return half
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    x, y, z = (sum(abs(a) * h for a, h in zip(row, half, strict=True)) for row in rows)
    return (x, y, z)


def _point(value: object, what: str) -> Point:
    point = as_point(value)
    if point is None:
        raise InputError(f"{what} is not three finite numbers; save the graph again")
    return point
