"""Any supported scene or room list, as rooms."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.rooms import Room
from roomtables.scenes import hm3d, matterport
from roomtables.scenes.dsg import dsg_scene
from roomtables.scenes.hm3d import read_hm3d
from roomtables.scenes.hovsg import hovsg_root, read_hovsg
from roomtables.scenes.matterport import read_house
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


_HEAD = 65_536
# Bytes of JSON beyond which it is no scene: with keys that a scene begins with, and without.
_LARGE, _LARGE_AND_STRANGE = 1 << 30, 1 << 26
_FIRST_KEY = re.compile(r'\s*\{\s*"((?:[^"\\]|\\.)*)"\s*:')
_GRAPH_KEYS = frozenset(
    {
        "SPARK_DSG_header",
        "directed",
        "edges",
        "graph",
        "layer_ids",
        "layer_keys",
        "layer_names",
        "mesh",
        "mesh_edges",
        "mesh_layer_id",
        "metadata",
        "multigraph",
        "nodes",
    }
)
SUPPORTED = (
    "Spark-DSG JSON, .sparkdsg, Matterport .house, HM3D .semantic.txt, an HOV-SG folder, "
    "JSON lines {room_id, objects}, nested JSON {rooms: […]}, or CSV (room_id, object[, room])"
)


class Format(Enum):
    """The formats that can be read."""

    ROOM_LINES = "JSON lines"
    CSV = "CSV"
    JSON = "JSON"
    SPARKDSG = ".sparkdsg"
    HOUSE = ".house"
    HM3D = ".semantic.txt"
    HOVSG = "HOV-SG folder"


_READERS: dict[Format, Callable[[Path, ReadOptions], Scene]] = {
    Format.ROOM_LINES: read_room_lines,
    Format.CSV: read_csv_rooms,
    Format.JSON: _read_json,
    Format.SPARKDSG: _read_sparkdsg,
    Format.HOUSE: read_house,
    Format.HM3D: read_hm3d,
    Format.HOVSG: read_hovsg,
}


def recognise(path: Path) -> Format:
    """The format of a file or an HOV-SG folder, from its first kilobytes.

    Raises
    ------
    InputError
        The path cannot be read, or holds none of the formats.
    """
    if path.is_dir():
        if hovsg_root(path):
            return Format.HOVSG
        raise InputError(
            f"{path}: neither .house files nor an HOV-SG graph in it; give {SUPPORTED}"
        )
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a scene file") from error
    return _recognise_head(head, path, size)


def _recognise_head(head: bytes, path: Path, size: int) -> Format:
    if not head.strip():
        if size > _HEAD:
            raise InputError(f"{path}: blank for {_HEAD} bytes; give {SUPPORTED}")
        return Format.ROOM_LINES  # no room at all is a room list too
    if head[:32].find(b"SPARK_DSG") >= 0 and not head.lstrip().startswith(b"{"):
        return Format.SPARKDSG
    text = head.decode("utf-8-sig", errors="replace")
    if text.startswith(matterport.MAGIC):
        return Format.HOUSE
    first_line = text.lstrip("\ufeff").split("\n", 1)[0].strip()
    if first_line == hm3d.HEADER:
        return Format.HM3D
    if text.lstrip()[:1] in "{[":
        return _recognise_json(text, path, size)
    columns = {cell.strip().strip('"') for cell in first_line.split(",")}
    if columns & {"room_id", "object"}:
        return Format.CSV
    if b"\0" not in head and path.suffix in (".jsonl", ".ndjson"):
        return Format.ROOM_LINES  # its reader names the line that is no JSON
    raise InputError(f"{path}: not a format that roomtables reads; give {SUPPORTED}")


def _recognise_json(text: str, path: Path, size: int) -> Format:
    """One JSON document, or JSON lines: a first line that is whole and a room tells them apart."""
    first_line, _, rest = text.strip().partition("\n")
    first_key = _FIRST_KEY.match(text)
    known = first_key is not None and first_key[1] in _GRAPH_KEYS | {"rooms"}
    try:
        value = json.loads(first_line)
    except (ValueError, RecursionError):
        value = None
    if isinstance(value, dict) and not known:
        document = {"rooms", "nodes"} & value.keys() and not rest.strip()
        return Format.JSON if document else Format.ROOM_LINES
    room = first_key is not None and first_key[1] in {"room_id", "objects", "room"}
    if room and first_line.strip() not in ("{", "["):
        return Format.ROOM_LINES
    if size > (_LARGE if known else _LARGE_AND_STRANGE):
        kind = "a graph without its mesh is smaller" if known else f"give {SUPPORTED}"
        raise InputError(f"{path}: {size / 2**30:.1f} GB of JSON is more than a scene; {kind}")
    return Format.JSON


def house_files(folder: Path) -> Iterator[Path]:
    """The ``.house`` files under a folder, in order of name."""
    yield from sorted(path for path in folder.rglob("*.house") if path.is_file())
