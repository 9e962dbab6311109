"""A Spark-DSG graph as a scene, and names written into it.

Reading decides which names the labels of objects have, and which rooms' labels are true. Writing
names rooms in the graph's JSON and changes nothing else there.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from roomtables.errors import InputError
from roomtables.scenes.dsg_graph import Graph, node_box, node_point, parse_graph, rooms_of, symbol
from roomtables.scenes.dsg_message import WrittenRoom, packed_probabilities, packed_text
from roomtables.scenes.hydra import load_label_names
from roomtables.scenes.matterport_labels import ROOM_NAMES
from roomtables.scenes.scene import (
    ReadOptions,
    Scene,
    SceneObject,
    SceneRoom,
    as_point,
    report_unassigned,
)
from roomtables.scenes.scene_file import SceneFile

# Where the name of a room comes from, see `name_origin`.
HYDRA, OURS, OTHER = "hydra", "roomtables", "other"
# Values of ``semantic_label`` that say nothing: −1, also where it is stored without a sign.
_UNSET = frozenset({-1, 2**32 - 1})
# What Hydra's room finder writes for every room: today, and in older files.
_UNLABELLED_ROOM = frozenset({0, 21})
# What Hydra calls a room that has no name, by its id: today, and in older files.
_HYDRAS_NAME = re.compile(r"|R\d+|R\(\d+\)")
_NO_NAME = frozenset({"", "unknown", "unlabeled", "unlabelled", "void", "none", "unset"})


def is_dsg(file: SceneFile) -> bool:
    """Whether a file is the JSON of a Spark-DSG graph."""
    return isinstance(file.document, dict) and "nodes" in file.document


def read_dsg(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from the JSON of a Spark-DSG graph.

    Raises
    ------
    InputError
        The graph is malformed (see `parse_graph`), or has no names for its labels (see
        `graph_scene`).
    """
    return graph_scene(parse_graph(file.document, str(file.path)), file.path.stem, options)


def graph_scene(graph: Graph, name: str, options: ReadOptions) -> Scene:
    """The graph as a scene: rooms by id, each with the objects that lead to it.

    Raises
    ------
    InputError
        No label space names the objects, a label is not in the YAML given, or a box or position is
        NaN.
    """
    names, origin = _object_names(graph, options) if graph.objects else ({}, "")
    things = _objects(graph, names, origin, options)
    rooms = set(graph.rooms)
    owner = rooms_of(
        things,
        lambda node: graph.parents.get(node, ()),
        rooms.__contains__,
        lambda child, parent: _distance(graph, child, parent),
    )
    held: dict[int | None, list[SceneObject]] = {}
    for key, thing in things.items():
        held.setdefault(owner[key], []).append(thing)
    found = [_room(graph, room, tuple(held.get(room, ()))) for room in graph.rooms]
    scene = Scene(name, found, tuple(held.get(None, ())), local_ids=True)
    report_unassigned(scene, len(things), options.warn)
    return scene


def _object_names(graph: Graph, options: ReadOptions) -> tuple[dict[int, str], str]:
    """The label space of the graph's objects, and where it came from.

    The YAML given, else the objects' own in the graph, else the mesh's.
    """
    if options.labelspace is not None:
        return load_label_names(options.labelspace), str(options.labelspace)
    own = f"_l{graph.object_layer}p0"
    for key in (own, "mesh"):
        if key in graph.label_spaces:
            return graph.label_spaces[key], f"label space {key}"
    raise InputError(
        f"{graph.source}: no label space names its objects' labels; give the one that the graph "
        "was made with: `--labelspace FILE.yaml` (Hydra's config/label_spaces)"
    )


def _objects(
    graph: Graph, names: Mapping[int, str], origin: str, options: ReadOptions
) -> dict[int, SceneObject]:
    things, unnamed = {}, []
    for key in graph.objects:
        attributes = graph.attributes(key)
        label = attributes.get("semantic_label")
        if isinstance(label, int) and label in names:
            where = f"{graph.source}, node {symbol(key)}"
            place = node_point(attributes, where), node_box(attributes, where)
            things[key] = SceneObject(symbol(key), names[label], *place)
        elif options.labelspace is not None and isinstance(label, int) and label not in _UNSET:
            raise InputError(
                f"{graph.source}: {origin} does not name label {label} of object {symbol(key)}; "
                "give the label space that the graph was made with"
            )
        else:
            unnamed.append(key)
    if unnamed:
        shown = f"{symbol(unnamed[0])} (label {graph.attributes(unnamed[0]).get('semantic_label')})"
        options.warn(
            f"{graph.source}: {len(unnamed)} of {len(graph.objects)} objects left out, as {origin} "
            f"does not name their labels: {shown}{', …' if len(unnamed) > 1 else ''}"
        )
    return things


def _distance(graph: Graph, child: int, parent: int) -> float:
    """Metres between two nodes; infinite where one has no position."""
    ends = [
        node_point(graph.attributes(key), f"{graph.source}, node {symbol(key)}")
        for key in (child, parent)
    ]
    if ends[0] is None or ends[1] is None:
        return float("inf")
    return math.dist(ends[0], ends[1])


def _room(graph: Graph, key: int, objects: tuple[SceneObject, ...]) -> SceneRoom:
    attributes = graph.attributes(key)
    box = node_box(attributes, f"{graph.source}, node {symbol(key)}")
    name = attributes.get("name")
    return SceneRoom(
        symbol(key),
        objects,
        name if isinstance(name, str) else "",
        _true_labels(graph, key),
        box,
        as_point(attributes.get("position")),
    )


def _true_labels(graph: Graph, room: int) -> tuple[str, ...]:
    """The room's true labels where the graph tells them; what roomtables wrote is no truth.

    Without a room label space, letters as Matterport's ground truth writes them (97 is ``a``, a
    bathroom) count, provided that every labelled room of the graph holds one.
    """
    attributes = graph.attributes(room)
    if "rule" in _provenance(attributes):
        return ()
    label = attributes.get("semantic_label")
    names = graph.label_spaces.get(f"_l{graph.room_layer}p0") or _letters(graph)
    if not isinstance(label, int) or label in _UNSET:
        return ()
    parts = (part.strip() for part in names.get(label, "").split(";"))
    return tuple(part for part in parts if part.lower() not in _NO_NAME)


def _provenance(attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    """What roomtables noted when it named a room."""
    match attributes.get("metadata"):
        case {"roomtables": dict() as found}:
            return found
        case _:
            return {}


def _letters(graph: Graph) -> dict[int, str]:
    """Matterport's room labels by the codes of their letters, if the rooms' labels are such."""
    letters = {ord(letter): name for letter, name in ROOM_NAMES.items()}
    labels = [graph.attributes(room).get("semantic_label") for room in graph.rooms]
    known = {label for label in labels if isinstance(label, int)} - _UNSET - _UNLABELLED_ROOM
    return letters if known <= letters.keys() else {}


@dataclass(frozen=True)
class NamedRoom:
    """A room's answer: its label, each candidate's probability, and where the answer came from."""

    label: str
    probabilities: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def packed(self) -> WrittenRoom:
        """What is written into the node of a room that has no metadata, but for its label."""
        return WrittenRoom(
            packed_text(self.label),
            probabilities=packed_probabilities(self.probabilities),
            metadata=packed_text(json.dumps({"roomtables": dict(self.provenance)})),
        )


def label_rooms(
    graph: Graph,
    named: Mapping[str, NamedRoom],
    labels: Iterable[str],
    *,
    keep_names: bool = False,
) -> int:
    """Write names into ``graph.document``; how many rooms were named.

    ``named`` goes by the rooms' symbols (``R0``); ``labels`` are all the rooms that could have been
    the answer. A room without an answer whose name is from roomtables gets back the name that
    stands for its id; any other keeps what it has. ``keep_names`` leaves rooms alone that bear a
    name which neither stands for their id nor is from roomtables.
    """
    origins = {key: _name_origin(graph, key) for key in graph.rooms}
    kept = {symbol(key) for key in graph.rooms if keep_names and origins[key] == OTHER}
    named = {key: room for key, room in named.items() if key not in kept}
    space = f"_l{graph.room_layer}p0"
    known = graph.label_spaces.get(space, {})
    ids, pairs = room_label_space(known, {room.label for room in named.values()}, labels)
    if named and len(pairs) > len(known):
        _child(_child(graph.document, "metadata"), "labelspaces")[space] = pairs
    for key in graph.rooms:
        room, attributes = named.get(symbol(key)), graph.attributes(key)
        if room is not None:
            attributes["name"] = room.label
            attributes["semantic_label"] = ids[room.label]
            attributes["semantic_class_probabilities"] = dict(room.probabilities)
            _child(attributes, "metadata")["roomtables"] = dict(room.provenance)
        elif origins[key] == OURS:
            attributes["name"] = symbol(key)
            attributes["semantic_label"] = unknown_room(known)
            attributes["semantic_class_probabilities"] = {}
            del attributes["metadata"]["roomtables"]
    return sum(symbol(key) in named for key in graph.rooms)


def _name_origin(graph: Graph, room: int) -> str:
    attributes = graph.attributes(room)
    return name_origin(attributes.get("name"), _provenance(attributes))


def name_origin(name: object, provenance: Mapping[str, Any]) -> str:
    """Where a room's name comes from: its id (``HYDRA``), roomtables (``OURS``), or ``OTHER``.

    ``provenance`` is what roomtables noted when it named the room, if it did.
    """
    if not isinstance(name, str) or _HYDRAS_NAME.fullmatch(name):
        return HYDRA
    return OURS if provenance.get("label") == name else OTHER


def unknown_room(names: Mapping[int, str]) -> int:
    """The ``semantic_label`` of a room without a name, in a room label space."""
    return next((key for key, name in names.items() if name.lower() in _NO_NAME), 2**32 - 1)


def room_label_space(
    known: Mapping[int, str], used: Iterable[str], labels: Iterable[str]
) -> tuple[dict[str, int], list[list[Any]]]:
    """An id for each room label, and the label space to write, as ``[id, name]`` pairs.

    A graph's own room label space keeps its ids and gains the ``used`` labels that it lacks; where
    it has none, all ``labels`` get ids from 1, and 0 is unknown, as Hydra numbers unlabelled rooms.
    """
    ids: dict[str, int] = {}
    for number, name in known.items():
        for part in name.split(";"):
            ids.setdefault(part.strip(), number)
    pairs: list[list[Any]] = [[number, name] for number, name in known.items()]
    pairs = pairs or [[0, "unknown"]]
    for label in sorted({*used} if known else {*used, *labels}):
        if label not in ids:
            ids[label] = max(number for number, _ in pairs) + 1
            pairs.append([ids[label], label])
    return ids, pairs


def _child(value: dict[str, Any], key: str) -> dict[str, Any]:
    """The dictionary under a key, made where there is none."""
    if not isinstance(value.get(key), dict):
        value[key] = {}
    child: dict[str, Any] = value[key]
    return child
