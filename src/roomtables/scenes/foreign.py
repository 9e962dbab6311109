"""Scene formats that roomtables does not read, but knows: each is refused by its own name."""

from __future__ import annotations

import re
from collections.abc import Set
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from roomtables.errors import InputError
from roomtables.scenes.scene_file import SceneFile

_GZIP = b"\x1f\x8b"
_KEY = re.compile(r'"(\w+)"\s*:')
# Keys of room lines, and of a Spark-DSG graph.
_OURS = frozenset({"room_id", "nodes"})
_ROOM_LINES = 'write its rooms as lines {"room_id": "1", "objects": ["bed", "lamp"]}'


@dataclass(frozen=True, slots=True)
class ForeignFormat:
    """A format by the JSON keys that tell it: all of ``keys``, and any of ``some`` where given."""

    name: str
    advice: str
    keys: frozenset[str]
    some: frozenset[str] = frozenset()

    def fits(self, keys: Set[str]) -> bool:
        return self.keys <= keys and (not self.some or bool(self.some & keys))


_FORMATS = (
    ForeignFormat(
        "a ProcTHOR house",
        f"{_ROOM_LINES}, each object under the room whose floorPolygon holds its position",
        frozenset({"rooms"}),
        frozenset({"floorPolygon", "proceduralParameters", "walls"}),
    ),
    ForeignFormat(
        "a list of 3DSSG's scans",
        f"{_ROOM_LINES}: a scan as a room, with the `label` of each of its objects",
        frozenset({"scans"}),
        frozenset({"scan", "objects", "relationships"}),
    ),
    ForeignFormat(
        "ScanNet's list of a scan's objects",
        f"{_ROOM_LINES}: the scan as a room, with the `label` of each of its segGroups",
        frozenset({"segGroups"}),
    ),
    ForeignFormat(
        "a scene instance of Habitat, as ReplicaCAD's",
        f"{_ROOM_LINES}, with the names that its object templates stand for",
        frozenset({"object_instances"}),
        frozenset({"stage_instance", "articulated_object_instances", "template_name"}),
    ),
    ForeignFormat(
        "a map of ConceptGraphs",
        f"{_ROOM_LINES}, with the `object_tag` of each object; the map has no rooms of its own",
        frozenset({"bbox_extent"}),
        frozenset({"bbox_center", "object_caption", "object_tag"}),
    ),
    ForeignFormat(
        "a list of ConceptGraphs' relations",
        f"{_ROOM_LINES}, with the tag of each object; the map has no rooms of its own",
        frozenset({"object1", "object2"}),
    ),
)
_PICKLED = ForeignFormat("a pickled map of ConceptGraphs", _ROOM_LINES, frozenset())


def refuse_foreign(file: SceneFile) -> None:
    """Refuse a file of a known format that roomtables does not read.

    Raises
    ------
    InputError
        It is one; the message names the format and says what to do.
    """
    found = _foreign_format(file)
    if found is not None:
        raise InputError(
            f"{file.path}: this is {found.name}, which roomtables does not read; {found.advice}"
        )


def _foreign_format(file: SceneFile) -> ForeignFormat | None:
    if file.head.startswith(_GZIP) and ".pkl" in file.path.suffixes:
        return _PICKLED
    keys = _keys(file) if file.is_json else frozenset()
    return next((known for known in _FORMATS if known.fits(keys)), None)


def _keys(file: SceneFile) -> Set[str]:
    """The keys of a JSON document and of the first entry in it; none of what roomtables reads.

    Of a document that is not to be decoded, as JSON lines, the keys in its first kilobytes.
    """
    document = None
    with suppress(InputError):  # what reads the file will say what is wrong with it
        document = file.document
    if document is None:
        keys = frozenset(_KEY.findall(file.text))
        return frozenset() if keys & _OURS else keys
    whole = document if isinstance(document, dict) else {}
    room = _first(whole.get("rooms"))
    if whole.keys() & _OURS or "objects" in room:
        return frozenset()
    inside = room or _first(next(iter(whole.values()), None) if whole else document)
    return whole.keys() | inside.keys()


def _first(value: object) -> dict[str, Any]:
    """An object, or the first of a list of objects; empty where it is neither."""
    entry = value[0] if isinstance(value, list) and value else value
    return entry if isinstance(entry, dict) else {}
