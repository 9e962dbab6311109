"""Room lists: JSON lines, nested JSON of rooms that hold objects, and CSV with an object a row."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from roomtables.csv_rows import read_csv
from roomtables.errors import InputError
from roomtables.limits import text_lines
from roomtables.rooms import Room, parse_room, parse_room_lines
from roomtables.scenes.scene import ReadOptions, Scene, SceneObject, SceneRoom, as_point
from roomtables.scenes.scene_file import SceneFile

_LINE_SUFFIXES = (".jsonl", ".ndjson")


def is_json_lines(file: SceneFile) -> bool:
    """Whether a file is JSON lines; a file of blanks is a list of no rooms.

    Text that is nothing else counts where the file name says JSON lines: the reader then names the
    line that is not JSON.
    """
    if file.is_folder:
        return False
    if file.is_json:
        return file.has_object_lines and not is_nested(file)
    if file.is_blank:
        return file.is_complete
    return file.path.suffix in _LINE_SUFFIXES and b"\0" not in file.head and not is_csv(file)


def read_json_lines(file: SceneFile, options: ReadOptions) -> Scene:
    """A JSON lines file of rooms as one scene; its lines are read as its rooms are asked for."""

    def rooms() -> Iterator[SceneRoom]:
        with file.path.open("rb") as lines:
            yield from json_lines_scene(text_lines(lines), str(file.path)).rooms

    return Scene(file.path.stem, rooms())


def json_lines_scene(lines: Iterable[str | bytes], source: str) -> Scene:
    """A scene of JSON lines, read as its rooms are asked for; errors name ``source`` and line."""
    return Scene(source, (_scene_room(room) for room in parse_room_lines(lines, source)))


def _scene_room(room: Room) -> SceneRoom:
    objects = tuple(
        SceneObject(f"{room.room_id}/{index}", name) for index, name in enumerate(room.objects)
    )
    return SceneRoom(room.room_id, objects, truth=room.truth, measures=room.measures)


def is_nested(file: SceneFile) -> bool:
    """Whether a file is a JSON document with ``rooms``."""
    return isinstance(file.document, dict) and "rooms" in file.document


def read_nested(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from nested JSON: ``{"rooms": [{"id", "name"?, "room"?, "objects": […]}]}``.

    ``objects`` holds ``{"id", "name"}`` entries or plain labels. ``room`` is the truth; ``name`` is
    what somebody called the room, and is not.

    Raises
    ------
    InputError
        A list or an entry is missing, or of the wrong type.
    """
    path, document = file.path, file.document
    rooms = document["rooms"]
    if not isinstance(rooms, list):
        raise InputError(f"{path}: `rooms` must be a list")
    loose = _nested_objects(document.get("unassigned", []), f"{path}, unassigned")
    found = [_nested_room(value, f"{path}, rooms[{i}]") for i, value in enumerate(rooms)]
    return Scene(path.stem, found, loose)


def _nested_room(value: object, where: str) -> SceneRoom:
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected an object with id and objects")
    room_id = value.get("id", value.get("room_id"))
    objects = _nested_objects(value.get("objects"), where)
    line = {"room_id": room_id, "room": value.get("room"), "objects": [o.name for o in objects]}
    room = _scene_room(parse_room(line, where))
    name = value.get("name")
    return replace(room, objects=objects, name=name if isinstance(name, str) else "")


def _nested_objects(values: object, where: str) -> tuple[SceneObject, ...]:
    if not isinstance(values, list):
        raise InputError(f"{where}: `objects` must be a list")
    return tuple(_nested_object(v, i, f"{where}, objects[{i}]") for i, v in enumerate(values))


def _nested_object(value: object, index: int, where: str) -> SceneObject:
    if isinstance(value, str):
        return SceneObject(str(index), value)
    if not isinstance(value, dict) or not isinstance(value.get("name"), str):
        raise InputError(f"{where}: expected an object with id and name")
    return SceneObject(str(value.get("id", index)), value["name"], as_point(value.get("position")))


def write_nested(scenes: Iterable[Scene]) -> Iterator[str]:
    """The scenes as one nested JSON document, a room at a time; only loose objects are held."""
    yield '{"rooms": ['
    unassigned: list[dict[str, Any]] = []
    separator = "\n"
    for scene in scenes:
        for room in scene.rooms:
            yield separator + json.dumps(room.as_json(), ensure_ascii=False)
            separator = ",\n"
        unassigned += [thing.as_json() for thing in scene.unassigned]
    yield f'\n], "unassigned": {json.dumps(unassigned, ensure_ascii=False)}}}\n'


def is_csv(file: SceneFile) -> bool:
    """Whether the first line names a column of rooms with objects."""
    columns = {cell.strip().strip('"') for cell in file.first_line.split(",")}
    return not file.is_json and bool(columns & {"room_id", "object"})


def read_csv_rooms(file: SceneFile, options: ReadOptions) -> Scene:
    """Rooms from a CSV with columns ``room_id``, ``object`` and optionally ``room``.

    One row per object; rows of a room need not be neighbours, and an empty ``object`` makes a room
    without objects.

    Raises
    ------
    InputError
        A column is missing, a row is malformed, or two rows give a room different true labels.
    """
    objects: dict[str, list[str]] = {}
    truths: dict[str, str] = {}
    for where, row in read_csv(file.path, required=("room_id", "object")):
        room_id, name, truth = (row.get(key, "").strip() for key in ("room_id", "object", "room"))
        if not room_id:
            raise InputError(f"{where}: empty `room_id`")
        names = objects.setdefault(room_id, [])
        names += [name] if name else []
        if truth and truths.setdefault(room_id, truth) != truth:
            before = truths[room_id][:40]
            room = room_id[:40]
            raise InputError(f"{where}: room {room} is `{truth[:40]}` here and `{before}` above")
    lines = (
        {"room_id": k, "room": truths.get(k), "objects": names} for k, names in objects.items()
    )
    rooms = [_scene_room(parse_room(line, str(file.path))) for line in lines]
    return Scene(file.path.stem, rooms)


def read_true_rooms(path: Path) -> dict[str, tuple[str, ...]]:
    """True labels by room id, from a CSV with columns ``room_id`` and ``room``.

    Raises
    ------
    InputError
        A column is missing, or a row is malformed.
    """
    names = {}
    for where, row in read_csv(path, required=("room_id", "room")):
        line = {"room_id": row["room_id"].strip(), "room": row["room"], "objects": []}
        names[row["room_id"].strip()] = parse_room(line, where).truth
    return names


def with_true_rooms(scene: Scene, names: Mapping[str, tuple[str, ...]]) -> Scene:
    """The scene with a list's true labels: by room id, or by what follows the id's ``/``."""

    def named(room: SceneRoom) -> SceneRoom:
        truth = names.get(room.room_id) or names.get(room.room_id.rpartition("/")[2])
        return replace(room, truth=truth) if truth else room

    return replace(scene, rooms=map(named, scene.rooms))
