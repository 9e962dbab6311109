"""What a file or folder holds, told by its first bytes and never by its name."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

from roomtables.errors import InputError
from roomtables.scenes import hm3d, matterport
from roomtables.scenes.hovsg import hovsg_root

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
