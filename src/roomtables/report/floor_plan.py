"""A scene as a floor plan: a panel per storey, rooms as boxes, objects as dots with their labels.

HTML holds the picture and a table of the rooms, and refers to no other file. Needs matplotlib, of
the extra ``report``.
"""

from __future__ import annotations

import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, needing
from roomtables.labels import normalise
from roomtables.report.text import drawn
from roomtables.scenes.scene import Box, Point, Scene, SceneRoom
from roomtables.storage.files import write_aside
from roomtables.wording import percent

_SUFFIXES = (".html", ".png", ".svg")
_RIGHT, _WRONG, _UNJUDGED = "#1b7f3b", "#c0392b", "#4a6fa5"
_STOREY = 1.5  # metres between two storeys at least
_MARGIN = 0.5  # metres around what stands for a room that has no box
_MOST_LABELS = 400  # objects beyond this stay dots: their labels would cover one another

Answers = Mapping[str, tuple[str, float]]  # by room id: a label, and its probability


def needs_matplotlib(output: Path) -> None:
    """Check, before any work, that the picture can be drawn.

    Raises
    ------
    InputError
        The file is to be neither HTML, PNG nor SVG.
    MissingExtraError
        matplotlib is not installed.
    """
    if output.suffix.lower() not in _SUFFIXES:
        raise InputError(f"{output}: a floor plan is {', '.join(_SUFFIXES)}; name the file so")
    with needing("drawing a floor plan"):
        import_module("matplotlib")


def draw(scene: Scene, answers: Answers, output: Path) -> int:
    """Draw a scene; the suffix of ``output`` says how. Returns how many rooms have a place in it.

    Raises
    ------
    InputError
        No room has a box, a position, or objects with positions.
    """
    rooms = {room.room_id: room for room in _placed(list(scene.rooms))}
    boxes = {key: box for key, room in rooms.items() if (box := _room_box(room)) is not None}
    if not boxes:
        raise InputError(f"{scene.name}: neither boxes nor positions to draw; give a scene graph")
    kind = output.suffix.lower().lstrip(".")
    picture = _picture(scene, rooms, boxes, answers, "png" if kind == "png" else "svg")
    if kind == "html":
        page = _page(scene.name, list(rooms.values()), answers, picture.decode())
        picture = page.encode(errors="replace")
    write_aside(output, picture)
    return len(boxes)


def _placed(rooms: Sequence[SceneRoom]) -> list[SceneRoom]:
    """The rooms without the positions that nobody set: where all are the origin, none was."""
    things = [thing for room in rooms for thing in room.objects]
    if not _are_set([thing.position for thing in things]):
        rooms = [
            replace(room, objects=tuple(replace(thing, position=None) for thing in room.objects))
            for room in rooms
        ]
    if not _are_set([room.position for room in rooms]):
        rooms = [replace(room, position=None) for room in rooms]
    return list(rooms)


def _are_set(positions: Sequence[Point | None]) -> bool:
    given = [position for position in positions if position is not None]
    return len(given) == 1 or any(any(position) for position in given)


def _room_box(room: SceneRoom) -> Box | None:
    """The room's own box, else one around its objects, else around its position, in metres.

    None where it has nothing of these; a box without floor counts for nothing.
    """
    if room.box is not None and all(room.box.high[axis] > room.box.low[axis] for axis in (0, 1)):
        return room.box
    points = [thing.position for thing in room.objects if thing.position is not None]
    points = points or ([] if room.position is None else [room.position])
    if not points:
        return None
    axes = list(zip(*points, strict=True))
    low, high = [min(axis) - _MARGIN for axis in axes], [max(axis) + _MARGIN for axis in axes]
    return Box((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _storeys(boxes: Mapping[str, Box]) -> list[list[str]]:
    """Rooms by storey, lowest first; one begins 1.5 m or more above the lowest room of the last."""
    levels: list[list[str]] = []
    floor = 0.0
    for key, box in sorted(boxes.items(), key=lambda item: (item[1].low[2], item[0])):
        if not levels or box.low[2] - floor >= _STOREY:
            levels.append([])
            floor = box.low[2]
        levels[-1].append(key)
    return levels


def _is_right(room: SceneRoom, answers: Answers) -> bool | None:
    """Whether the answer is any of the true labels; None where either is missing."""
    if not room.truth or room.room_id not in answers:
        return None
    return normalise(answers[room.room_id][0]) in map(normalise, room.truth)


def _picture(
    scene: Scene,
    rooms: Mapping[str, SceneRoom],
    boxes: Mapping[str, Box],
    answers: Answers,
    kind: str,
) -> bytes:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    levels = _storeys(boxes)
    total = sum(len(room.objects) for room in rooms.values())
    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "roomtables", "svg.fonttype": "none"}):
        figure = Figure(figsize=(10 * len(levels), 9), layout="constrained")
        panels = figure.subplots(1, len(levels), squeeze=False, sharex=True, sharey=True)[0]
        for panel, keys in zip(panels, levels, strict=True):
            for key in keys:
                _draw_room(panel, rooms[key], boxes[key], answers, total <= _MOST_LABELS)
            panel.set_aspect("equal")
            panel.set_xlabel("x [m]")
            panel.set_ylabel("y [m]")
            panel.autoscale_view()
        figure.suptitle(drawn(scene.name))
        metadata = {"Date": None} if kind == "svg" else {"Software": None}
        figure.savefig(buffer, format=kind, dpi=120, metadata=metadata)
    return buffer.getvalue()


def _draw_room(panel: Any, room: SceneRoom, box: Box, answers: Answers, named: bool) -> None:
    from matplotlib.patches import Rectangle

    colour = _colour(_is_right(room, answers))
    (x, y, _), (right, top, _) = box.low, box.high
    panel.add_patch(Rectangle((x, y), right - x, top - y, fill=True, alpha=0.12, facecolor=colour))
    panel.add_patch(Rectangle((x, y), right - x, top - y, fill=False, edgecolor=colour, lw=1.5))
    panel.text(
        x + 0.05, top - 0.05, drawn(_caption(room, answers)), color=colour, va="top", fontsize=9
    )
    for thing in room.objects:
        if thing.position is not None:
            panel.plot(thing.position[0], thing.position[1], ".", color="#555555", markersize=4)
            if named:
                panel.annotate(
                    drawn(thing.name),
                    thing.position[:2],
                    textcoords="offset points",
                    xytext=(3, 2),
                    fontsize=6,
                    color="#555555",
                )


def _colour(right: bool | None) -> str:
    return _UNJUDGED if right is None else _RIGHT if right else _WRONG


def _caption(room: SceneRoom, answers: Answers) -> str:
    truth = " or ".join(room.truth)
    if room.room_id not in answers:
        return f"{room.room_id}\n{truth or 'no answer'}"
    label, probability = answers[room.room_id]
    wrong = f"\n(true: {truth})" if _is_right(room, answers) is False else ""
    return f"{room.room_id}\n{label} {percent(probability, 0)}{wrong}"


def _page(name: str, rooms: Sequence[SceneRoom], answers: Answers, picture: str) -> str:
    svg = picture[picture.index("<svg") :]
    rows = "\n".join(_row(room, answers) for room in rooms)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(name)}</title>
<style>
body {{ font-family: sans-serif; margin: 4vw; }}
svg {{ max-width: 100%; height: auto; }}
td, th {{ text-align: left; padding: 0.2em 1em 0.2em 0; vertical-align: top; }}
div {{ overflow-x: auto; }}
@media (max-width: 600px) {{ td, th {{ font-size: 13px; padding-right: 0.4em; }} }}
</style></head><body>
<h1>{html.escape(name)}</h1>
{svg}
<div><table>
<tr><th>room</th><th>answer</th><th>probability</th><th>truth</th><th>objects</th></tr>
{rows}
</table></div></body></html>
"""


def _row(room: SceneRoom, answers: Answers) -> str:
    label, probability = answers.get(room.room_id, ("", None))
    cells = [
        room.room_id,
        label,
        "" if probability is None else f"{probability:.3f}",
        " or ".join(room.truth),
        ", ".join(sorted(thing.name for thing in room.objects)),
    ]
    colour = _colour(_is_right(room, answers))
    inside = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
    return f'<tr style="color:{colour}">{inside}</tr>'
