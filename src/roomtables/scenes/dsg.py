"""A Spark-DSG graph as a scene: which names its labels have, and which rooms' labels are true."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.scenes.dsg_graph import Graph, node_box, node_point, parse_graph, rooms_of, symbol
from roomtables.scenes.hydra import load_label_names
from roomtables.scenes.matterport_labels import ROOM_NAMES
from roomtables.scenes.scene import ReadOptions, Scene, SceneObject, SceneRoom, report_unassigned

UNSET = frozenset({-1, 2**32 - 1})
NO_NAME = frozenset({"", "unknown", "unlabeled", "unlabelled", "void", "none", "unset"})


def object_names(graph: Graph, options: ReadOptions) -> tuple[dict[int, str], str]:
    """The label space of the graph's objects, and where it came from.

    The YAML given, else the objects' own in the graph, else the mesh's.

    Raises
    ------
    InputError
        There is none, or an object's label is not in the YAML given.
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


def truth_of(graph: Graph, room: int) -> tuple[str, ...]:
    """The room's true labels where the graph tells them; what roomtables wrote is no truth.

    Without a room label space, letters as Matterport's ground truth writes them (97 is ``a``, a
    bathroom) count, provided that every labelled room of the graph holds one.
    """
    attributes = graph.attributes(room)
    if "rule" in _provenance(attributes):
        return ()
    label = attributes.get("semantic_label")
    names = graph.label_spaces.get(f"_l{graph.room_layer}p0") or _letters(graph)
    if not isinstance(label, int) or label in UNSET:
        return ()
    parts = (part.strip() for part in names.get(label, "").split(";"))
    return tuple(part for part in parts if part.lower() not in NO_NAME)


def _provenance(attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    match attributes.get("metadata"):
        case {"roomtables": dict() as found}:
            return found
        case _:
            return {}


def _letters(graph: Graph) -> dict[int, str]:
    letters = {ord(letter): name for letter, name in ROOM_NAMES.items()}
    labels = [graph.attributes(room).get("semantic_label") for room in graph.rooms]
    known = {label for label in labels if isinstance(label, int)} - UNSET - {0, 21}
    return letters if known <= letters.keys() else {}


def graph_scene(graph: Graph, name: str, options: ReadOptions) -> Scene:
    """The graph as a scene: rooms by id, each with the objects that lead to it.

    Raises
    ------
    InputError
        No label space names the objects, a label is not in the YAML given, or a box or position is
        NaN.
    """
    names, origin = object_names(graph, options) if graph.objects else ({}, "")
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
        elif options.labelspace is not None and isinstance(label, int) and label not in UNSET:
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


def _room(graph: Graph, key: int, objects: tuple[SceneObject, ...]) -> SceneRoom:
    attributes = graph.attributes(key)
    box = node_box(attributes, f"{graph.source}, node {symbol(key)}")
    name = attributes.get("name")
    return SceneRoom(
        symbol(key), objects, name if isinstance(name, str) else "", truth_of(graph, key), box
    )


def _distance(graph: Graph, child: int, parent: int) -> float:
    ends = [
        node_point(graph.attributes(key), f"{graph.source}, node {symbol(key)}")
        for key in (child, parent)
    ]
    if ends[0] is None or ends[1] is None:
        return float("inf")
    return math.dist(ends[0], ends[1])


def dsg_scene(document: Mapping[str, Any], path: Path, options: ReadOptions) -> Scene:
    """A scene from the decoded JSON of a Spark-DSG graph."""
    return graph_scene(parse_graph(document, str(path)), path.stem, options)
