"""Any supported scene or room list, as rooms."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.rooms import Room
from roomtables.scenes.dsg import dsg_scene
from roomtables.scenes.hm3d import read_hm3d
from roomtables.scenes.hovsg import read_hovsg
from roomtables.scenes.matterport import read_house
from roomtables.scenes.recognise import SUPPORTED, Format, house_files, recognise
from roomtables.scenes.room_lists import (
    nested_scene,
    read_csv_rooms,
    read_room_lines,
    room_lines_scene,
)
from roomtables.scenes.scene import ReadOptions, Scene, Warn, silent
from roomtables.scenes.sparkdsg import sparkdsg_document

STANDARD_INPUT = Path("-")


def load_json(path: Path) -> Any:
    """A decoded JSON file.

    Raises
    ------
    InputError
        It is not UTF-8, or not JSON: often a file that was cut short.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason})") from error
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}, line {error.lineno}: invalid JSON ({error.msg}, character {error.pos}); "
            "was the file cut short? save the graph again"
        ) from error
    except (RecursionError, MemoryError) as error:
        raise InputError(f"{path}: nested too deeply or too large to be a scene") from error


def load_graph_document(path: Path) -> dict[str, Any]:
    """The JSON of a Spark-DSG graph, mesh and all, from ``.json`` or ``.sparkdsg``.

    Raises
    ------
    InputError
        The file is malformed, or of another format.
    MissingExtraError
        A ``.sparkdsg`` file needs the extra ``scene-graphs``.
    """
    found = recognise(path)
    if found is Format.SPARKDSG:
        return sparkdsg_document(path, include_mesh=True)
    if found is Format.JSON:
        match load_json(path):
            case {"nodes": _} as document:
                return dict(document)
    raise InputError(
        f"{path}: not a Spark-DSG graph, so no names can be written into it; "
        "`roomtables classify --input` labels every format"
    )


def _read_json(path: Path, options: ReadOptions) -> Scene:
    match load_json(path):
        case {"nodes": _} as document:
            return dsg_scene(document, path, options)
        case {"rooms": _} as document:
            return nested_scene(document, path)
        case _:
            raise InputError(f"{path}: JSON, but no scene that roomtables knows; give {SUPPORTED}")


def _read_sparkdsg(path: Path, options: ReadOptions) -> Scene:
    return dsg_scene(sparkdsg_document(path, include_mesh=False), path, options)


_READERS: dict[Format, Callable[[Path, ReadOptions], Scene]] = {
    Format.ROOM_LINES: read_room_lines,
    Format.CSV: read_csv_rooms,
    Format.JSON: _read_json,
    Format.SPARKDSG: _read_sparkdsg,
    Format.HOUSE: read_house,
    Format.HM3D: read_hm3d,
    Format.HOVSG: read_hovsg,
}


def scene_files(path: Path) -> list[Path]:
    """The scenes that a path stands for: itself, or every ``.house`` file in the folder."""
    return (list(house_files(path)) if path.is_dir() else []) or [path]


def read_scene(path: Path, options: ReadOptions | None = None) -> Scene:
    """One scene, its format told by its content; ``-`` is JSON lines on standard input.

    Raises
    ------
    InputError
        The file is of no known format, or malformed.
    MissingExtraError
        A ``.sparkdsg`` file or a label-space YAML needs the extra ``scene-graphs``.
    """
    if path == STANDARD_INPUT:
        return room_lines_scene(sys.stdin.buffer, "standard input")
    try:
        return _READERS[recognise(path)](path, options or ReadOptions())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a scene file") from error


def read_scenes(path: Path, options: ReadOptions | None = None) -> Iterator[Scene]:
    """The scenes that a path stands for, one at a time; raises as `read_scene` does."""
    for file in scene_files(path):
        yield read_scene(file, options)


def read_rooms(
    path: Path | str,
    *,
    labelspace: Path | None = None,
    keep_all: bool = False,
    object_labels: str = "mpcat40",
    category_mapping: Path | None = None,
    warn: Warn = silent,
) -> Iterator[Room]:
    """Rooms from any scene graph or room list, lazily, in the scene's order.

    Parameters
    ----------
    path
        A scene, a room list, a folder of ``.house`` files, or ``-`` for JSON lines on standard
        input. The content decides the format.
    labelspace
        Hydra's label-space YAML, for a graph that does not name its labels.
    keep_all
        Keep the Matterport rooms that the paper drops: outdoor, unnamed, empty.
    object_labels
        ``mpcat40`` or ``nyuclass``: which names the objects of a ``.house`` file get.
    category_mapping
        Matterport's ``category_mapping.tsv``, for ``nyuclass``.
    warn
        Receives one line about each thing left out, such as objects that lie in no room.

    Raises
    ------
    InputError, MissingExtraError
        As `read_scene`.
    """
    options = ReadOptions(labelspace, keep_all, object_labels, category_mapping, warn)
    for scene in read_scenes(Path(path), options):
        for room in scene.rooms:
            yield room.as_room()
