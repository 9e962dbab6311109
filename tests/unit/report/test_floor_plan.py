"""Rooms stand where their boxes, their objects or they themselves are, not on one spot."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from roomtables.errors import InputError
from roomtables.report.floor_plan import draw
from roomtables.scenes.scene import Box, Point, Scene, SceneObject, SceneRoom

pytest.importorskip("matplotlib", reason="drawing needs the extra `report`")

ORIGIN = (0.0, 0.0, 0.0)
FLAT = Box(ORIGIN, ORIGIN)


def room(
    name: str,
    points: Sequence[Point | None] = (),
    position: Point | None = None,
    box: Box | None = None,
) -> SceneRoom:
    objects = tuple(SceneObject(f"{name}{at}", "lamp", point) for at, point in enumerate(points))
    return SceneRoom(name, objects, box=box, position=position)


def places(tmp_path: Path, rooms: list[SceneRoom]) -> dict[str, tuple[float, float]]:
    """Where each room's caption is in the picture, in points: x rightward, y downward."""
    draw(Scene("made", rooms), {}, tmp_path / "plan.svg")
    text = (tmp_path / "plan.svg").read_text(encoding="utf-8")
    captions = re.findall(r"translate\(([-\d.]+) ([-\d.]+)\)\">(\w+)</text>", text)
    return {name: (float(x), float(y)) for x, y, name in captions}


@pytest.mark.parametrize("box", [None, FLAT, Box((0.0, 0.0, 0.0), (0.0, 0.0, 3.0))])
def test_rooms_without_extent_stand_around_their_objects(tmp_path: Path, box: Box | None) -> None:
    rooms = [
        room("west", [(0.0, 0.0, 1.0), (1.0, 1.0, 1.0)], ORIGIN, box),
        room("east", [(8.0, 0.0, 1.0), None], ORIGIN, box),
        room("north", [(0.0, 9.0, 1.0)], ORIGIN, box),
    ]
    found = places(tmp_path, rooms)
    assert found["west"][0] < found["east"][0]
    assert found["north"][1] < found["west"][1]


def test_rooms_without_placed_objects_stand_at_their_own_position(tmp_path: Path) -> None:
    rooms = [
        room("west", [ORIGIN, ORIGIN], (-5.0, 2.0, 0.0)),
        room("east", [ORIGIN], (5.0, 2.0, 0.0)),
        room("empty", [], (0.0, -4.0, 0.0)),
    ]
    found = places(tmp_path, rooms)
    assert found["west"][0] < found["empty"][0] < found["east"][0]
    assert found["empty"][1] > found["west"][1]


def test_a_room_without_any_place_is_left_out_and_counted(tmp_path: Path) -> None:
    rooms = [room("here", [(1.0, 1.0, 0.0)]), room("nowhere", [None])]
    assert draw(Scene("made", rooms), {}, tmp_path / "plan.html") == 1
    page = (tmp_path / "plan.html").read_text(encoding="utf-8")
    assert "<td>nowhere</td>" in page


def test_where_nobody_set_a_position_nothing_is_drawn(tmp_path: Path) -> None:
    rooms = [room("a", [ORIGIN, ORIGIN], ORIGIN, FLAT), room("b", [ORIGIN], ORIGIN)]
    with pytest.raises(InputError, match="neither boxes nor positions"):
        draw(Scene("made", rooms), {}, tmp_path / "plan.svg")
