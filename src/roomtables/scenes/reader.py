"""Any supported scene or room list: the table of formats, and reading by it.

To add a format, write a module with two functions and give it a row in `FORMATS`. The first tells
from a `SceneFile` (a file's first kilobytes, or a folder) whether the file is of the format; the
second reads it into a `Scene`. A format with a JSON document of its own finds the decoded document
in `SceneFile.document`. ``hm3d.py`` is the shortest example.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from roomtables.errors import InputError
from roomtables.limits import JSON_BYTES, SCENE_BYTES, text_lines
from roomtables.rooms import Room
from roomtables.scenes.dsg import is_dsg, read_dsg
from roomtables.scenes.dsg_graph import Graph, parse_graph
from roomtables.scenes.foreign import refuse_foreign
from roomtables.scenes.hm3d import is_hm3d, read_hm3d
from roomtables.scenes.hovsg import is_hovsg, read_hovsg
from roomtables.scenes.matterport import is_house, read_house
from roomtables.scenes.room_lists import (
    is_csv,
    is_json_lines,
    is_nested,
    json_lines_scene,
    read_csv_rooms,
    read_json_lines,
    read_nested,
)
from roomtables.scenes.scene import ReadOptions, Scene, Warn, silent
from roomtables.scenes.scene_file import HEAD, SceneFile
from roomtables.scenes.sparkdsg import is_sparkdsg, read_sparkdsg, sparkdsg_document

STANDARD_INPUT = Path("-")


@dataclass(frozen=True, slots=True)
class Format:
    """A format: its name in error messages, how it is recognised, and its reader."""

    name: str
    recognises: Callable[[SceneFile], bool]
    read: Callable[[SceneFile, ReadOptions], Scene]


# The first format that recognises a file reads it.
FORMATS = (
    Format("Spark-DSG JSON", is_dsg, read_dsg),
    Format(".sparkdsg", is_sparkdsg, read_sparkdsg),
    Format("Matterport .house", is_house, read_house),
    Format("HM3D .semantic.txt", is_hm3d, read_hm3d),
    Format("an HOV-SG folder", is_hovsg, read_hovsg),
    Format("JSON lines {room_id, objects}", is_json_lines, read_json_lines),
    Format("nested JSON {rooms: […]}", is_nested, read_nested),
    Format("CSV (room_id, object[, room])", is_csv, read_csv_rooms),
)
SUPPORTED = ", ".join(format_.name for format_ in FORMATS[:-1]) + f", or {FORMATS[-1].name}"


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
        input.
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


def read_scenes(path: Path, options: ReadOptions | None = None) -> Iterator[Scene]:
    """The scenes that a path stands for, one at a time; raises as `read_scene` does."""
    for file in scene_files(path):
        yield read_scene(file, options)


def scene_files(path: Path) -> list[Path]:
    """The scenes that a path stands for: every ``.house`` file under a folder, else the path."""
    houses = path.rglob("*.house") if path.is_dir() else ()
    return sorted(house for house in houses if house.is_file()) or [path]


def read_scene(path: Path, options: ReadOptions | None = None) -> Scene:
    """One scene of any format; ``-`` is JSON lines on standard input.

    Raises
    ------
    InputError
        The file is of no known format, or malformed.
    MissingExtraError
        A ``.sparkdsg`` file or a label-space YAML needs the extra ``scene-graphs``.
    """
    if path == STANDARD_INPUT:
        return json_lines_scene(text_lines(sys.stdin.buffer), "standard input")
    file = _open(path)
    try:
        return _format_of(file).read(file, options or ReadOptions())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a scene file") from error


def read_graph(path: Path) -> Graph:
    """A Spark-DSG graph with its mesh, from ``.json`` or ``.sparkdsg``, to write names into.

    Raises
    ------
    InputError
        The file is malformed, or of another format.
    MissingExtraError
        A ``.sparkdsg`` file needs the extra ``scene-graphs``.
    """
    file = _open(path)
    if is_sparkdsg(file):
        return parse_graph(sparkdsg_document(path, include_mesh=True), str(path))
    if is_dsg(file):
        return parse_graph(file.document, str(path))
    if not file.is_json:
        _format_of(file)  # a file of no format at all is told so
    raise InputError(
        f"{path}: not a Spark-DSG graph, so no names can be written into it; "
        "`roomtables classify --input` labels every format"
    )


def _open(path: Path) -> SceneFile:
    """The file, unless it is JSON too large to be decoded, or of a format known but not read."""
    file = SceneFile.open(path)
    refuse_foreign(file)
    known = file.has_document_key
    is_document = file.is_json and not file.has_object_lines
    if is_document and file.size > (SCENE_BYTES if known else JSON_BYTES):
        advice = "a graph without its mesh is smaller" if known else f"give {SUPPORTED}"
        size = f"{file.size / 2**30:.1f} GB"
        raise InputError(f"{path}: {size} of JSON is more than a scene; {advice}")
    return file


def _format_of(file: SceneFile) -> Format:
    """The first format that recognises the file."""
    for format_ in FORMATS:
        if format_.recognises(file):
            return format_
    if file.is_folder:
        problem = "neither .house files nor an HOV-SG graph in it"
    elif file.is_json:
        problem = "JSON, but no scene that roomtables knows"
    elif file.is_blank:
        problem = f"blank for {HEAD} bytes"
    else:
        problem = "not a format that roomtables reads"
    raise InputError(f"{file.path}: {problem}; give {SUPPORTED}")
