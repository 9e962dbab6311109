"""HOV-SG folders: ``rooms/<id>.json`` lists object ids, ``objects/<id>.json`` names an object.

HOV-SG names rooms itself, by CLIP or a language model; that name is a prediction, so it is read as
the room's name and never as the truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.limits import JSON_BYTES, MalformedError, json_value, read_bytes
from roomtables.scenes.scene import ReadOptions, Scene, SceneObject, SceneRoom, report_unassigned
from roomtables.scenes.scene_file import SceneFile


def is_hovsg(file: SceneFile) -> bool:
    """Whether a folder holds an HOV-SG graph."""
    return file.is_folder and _root(file.path) is not None


def read_hovsg(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from an HOV-SG folder; rooms in order of their ids.

    Raises
    ------
    InputError
        A file is not JSON, or lacks ``room_id``, ``objects`` or ``name``.
    """
    root = _root(file.path)
    if root is None:
        raise InputError(f"{file.path}: no rooms/*.json in it; give the folder that HOV-SG wrote")
    found = map(_object, sorted((root / "objects").glob("*.json")))
    objects = {thing.object_id: thing for thing in found}
    rooms, held = [], set()
    for path in sorted((root / "rooms").glob("*.json")):
        value = _load(path)
        ids = [str(key) for key in _field(value, "objects", list, path)]
        missing = [key for key in ids if key not in objects]
        if missing:
            options.warn(f"{path}: no objects/{missing[0]}.json ({len(missing)} objects left out)")
        held.update(ids)
        name = value.get("name")
        rooms.append(
            SceneRoom(
                str(_field(value, "room_id", (str, int), path)),
                tuple(objects[key] for key in ids if key in objects),
                name if isinstance(name, str) else "",
            )
        )
    unassigned = tuple(thing for key, thing in objects.items() if key not in held)
    scene = Scene(file.path.name, rooms, unassigned, local_ids=True)
    report_unassigned(scene, len(objects), options.warn)
    return scene


def _root(folder: Path) -> Path | None:
    """The folder that holds ``rooms/*.json``, this one or its ``graph``; None without one."""
    for root in (folder, folder / "graph"):
        if any((root / "rooms").glob("*.json")):
            return root
    return None


def _object(path: Path) -> SceneObject:
    value = _load(path)
    key = value.get("object_id", path.stem)
    return SceneObject(str(key), _field(value, "name", str, path))


def _load(path: Path) -> dict[str, Any]:
    try:
        value = json_value(read_bytes(path, JSON_BYTES))
    except MalformedError as error:
        raise InputError(f"{path}: {error}; write the HOV-SG graph again") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object")
    return value


def _field(value: dict[str, Any], key: str, kind: type | tuple[type, ...], path: Path) -> Any:
    found = value.get(key)
    if not isinstance(found, kind):
        raise InputError(f"{path}: `{key}` is missing or of the wrong type")
    return found
