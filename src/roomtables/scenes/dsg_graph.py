"""The JSON of a Spark-DSG scene graph, of every generation: nodes, parents, label spaces, boxes.

Needs no package beside Python. Of an edge's two nodes, the one in the higher layer is the parent,
whichever way the edge was written, so parents cannot run in a circle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from roomtables.errors import InputError
from roomtables.scenes.scene import Box, Point, are_finite, as_point

_OBJECT_TYPES = ("ObjectNodeAttributes", "KhronosObjectAttributes")
_DEFAULT_LAYERS = {"OBJECTS": 2, "ROOMS": 4}
_INVALID_BOXES = ("INVALID", 0)


@dataclass(frozen=True, slots=True)
class Graph:
    """A graph: nodes by id, and each node's parents in higher layers.

    ``document`` is the decoded JSON that holds the very same nodes; ``source`` names its file in
    error messages. ``objects`` and ``rooms`` are ids, ascending.
    """

    document: dict[str, Any]
    source: str
    nodes: dict[int, dict[str, Any]]
    parents: dict[int, list[int]]
    objects: list[int]
    rooms: list[int]
    label_spaces: dict[str, dict[int, str]]
    room_layer: int
    object_layer: int

    def attributes(self, node: int) -> dict[str, Any]:
        """What the graph says about a node."""
        found: dict[str, Any] = self.nodes[node]["attributes"]
        return found


def parse_graph(document: dict[str, Any], source: str) -> Graph:
    """A graph from decoded JSON.

    Raises
    ------
    InputError
        A node, an edge or a label space is malformed, an id does not fit 64 bits or occurs twice,
        an edge names a node that is not there, or the graph has no room.
    """
    layers = _layers(document)
    nodes = _nodes(document, source)
    kinds = {key: node["attributes"].get("type") for key, node in nodes.items()}
    rooms = [key for key, node in nodes.items() if node["layer"] == layers["ROOMS"]]
    objects = [
        key
        for key, node in nodes.items()
        if node["layer"] == layers["OBJECTS"]
        and (kinds[key] in _OBJECT_TYPES or (kinds[key] is None and symbol(key)[0] in "Oo"))
    ]
    if not rooms:
        raise InputError(
            f"{source}: no node in the ROOMS layer, so there is nothing to label; let Hydra find "
            "rooms (its backend's `rooms` update functor) and save the graph again"
        )
    return Graph(
        document,
        source,
        nodes,
        _parents(document, nodes, source),
        sorted(objects),
        sorted(rooms),
        label_spaces(document, source),
        layers["ROOMS"],
        layers["OBJECTS"],
    )


def _layers(document: Mapping[str, Any]) -> dict[str, int]:
    """The numbers of the layers, as the graph names them."""
    layers = dict(_DEFAULT_LAYERS)
    names = document.get("layer_names")
    for name in layers:
        match names.get(name) if isinstance(names, dict) else None:
            case int() as number:
                layers[name] = number
            case {"layer": int() as number}:
                layers[name] = number
    return layers


def _nodes(document: Mapping[str, Any], source: str) -> dict[int, dict[str, Any]]:
    values = document.get("nodes")
    if not isinstance(values, list):
        raise InputError(f"{source}: `nodes` must be a list; is this a Spark-DSG scene graph?")
    nodes: dict[int, dict[str, Any]] = {}
    for index, node in enumerate(values):
        match node:
            case {"id": int() as key, "layer": int(), "attributes": dict()} if key is not True:
                pass
            case _:
                raise InputError(f"{source}, nodes[{index}]: expected id, layer and attributes")
        if not 0 <= key < 2**64:
            raise InputError(f"{source}, nodes[{index}]: id {key} does not fit 64 bits")
        if key in nodes:
            raise InputError(f"{source}, nodes[{index}]: id {key} ({symbol(key)}) occurs twice")
        nodes[key] = node
    return nodes


def _parents(
    document: Mapping[str, Any], nodes: Mapping[int, dict[str, Any]], source: str
) -> dict[int, list[int]]:
    edges = document.get("edges", [])
    if not isinstance(edges, list):
        raise InputError(f"{source}: `edges` must be a list")
    parents: dict[int, list[int]] = {}
    for index, edge in enumerate(edges):
        match edge:
            case {"source": int() as a, "target": int() as b}:
                pass
            case _:
                raise InputError(f"{source}, edges[{index}]: expected source and target")
        if a not in nodes or b not in nodes:
            missing = a if a not in nodes else b
            raise InputError(f"{source}, edges[{index}]: no node has the id {missing}")
        low, high = sorted((a, b), key=lambda key: int(nodes[key]["layer"]))
        if nodes[low]["layer"] < nodes[high]["layer"] and high not in parents.get(low, ()):
            parents.setdefault(low, []).append(high)
    return parents


def label_spaces(document: Mapping[str, Any], source: str) -> dict[str, dict[int, str]]:
    """The label spaces in a graph's metadata: by layer key, each label id's name.

    Raises
    ------
    InputError
        One is not a list of ``[id, name]`` pairs.
    """
    metadata = document.get("metadata")
    spaces = metadata.get("labelspaces") if isinstance(metadata, dict) else None
    if not isinstance(spaces, dict):
        return {}
    found = {}
    for key, pairs in spaces.items():
        try:
            items = pairs.items() if isinstance(pairs, dict) else pairs
            found[key] = {int(label): str(name) for label, name in items}
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{source}: label space {key} is not a list of [id, name] pairs"
            ) from error
    return {key: names for key, names in found.items() if names}


def rooms_of(
    children: Iterable[int],
    parents: Callable[[int], Sequence[int]],
    is_room: Callable[[int], bool],
    distance: Callable[[int, int], float],
) -> dict[int, int | None]:
    """The room that each child belongs to, found through its parents; None where there is none.

    With several parents, the room that most of them lead to; of equals the one whose parent is
    nearest to the child, then the one with the least id.
    """
    reached: dict[int, frozenset[int]] = {}

    def climb(node: int) -> frozenset[int]:
        if node not in reached:
            reached[node] = frozenset()  # ends the climb, should parents run in a circle
            found = {node} if is_room(node) else set().union(*map(climb, parents(node)))
            reached[node] = frozenset(found)
        return reached[node]

    def room(child: int) -> int | None:
        above = parents(child)
        found = climb(above[0]) if len(above) == 1 else frozenset().union(*map(climb, above))
        return next(iter(found), None) if len(found) <= 1 else _vote(child, above, climb, distance)

    return {child: room(child) for child in children}


def _vote(
    child: int,
    parents: Iterable[int],
    climb: Callable[[int], frozenset[int]],
    distance: Callable[[int, int], float],
) -> int:
    """The room of a child that leads to several."""
    ways = [(room, parent) for parent in parents for room in climb(parent)]
    votes = Counter(room for room, _ in ways)
    best = max(votes.values())
    near = [(distance(child, parent), room) for room, parent in ways if votes[room] == best]
    return min(near)[1]


def symbol(node: int) -> str:
    """A node's id as Spark-DSG prints it: a letter and an index, ``R0``."""
    letter = chr(node >> 56)
    plain = letter.isascii() and letter.isalpha()
    return f"{letter}{node & (2**56 - 1)}" if plain else str(node)


def node_point(attributes: Mapping[str, Any], where: str) -> Point | None:
    """The node's position in metres; None where it has none.

    Raises
    ------
    InputError
        It is not three finite numbers.
    """
    if attributes.get("position") is None:
        return None
    return _point(attributes["position"], f"{where}: position")


def node_box(attributes: Mapping[str, Any], where: str) -> Box | None:
    """The node's axis-aligned box in metres, around an oriented one where it is that.

    None where the graph marks it invalid, gives none, or it has no extent.

    Raises
    ------
    InputError
        It holds what is not a finite number (JSON writes NaN as null).
    """
    match attributes.get("bounding_box"):
        case {"type": kind} if kind in _INVALID_BOXES:
            return None
        case {"min": low, "max": high}:
            box = Box(_point(low, f"{where}: box"), _point(high, f"{where}: box"))
        case {"dimensions": size, "world_P_center": centre, **rest}:
            middle = _point(centre, f"{where}: box")
            half = _turned(_point(size, f"{where}: box"), rest.get("world_R_center"), where)
            box = _around(middle, half)
        case _:
            return None
    return box if box.low != box.high else None


def _around(middle: Point, half: Point) -> Box:
    low, high = (
        (middle[0] + sign * half[0], middle[1] + sign * half[1], middle[2] + sign * half[2])
        for sign in (-1, 1)
    )
    return Box(low, high)


def _turned(size: Point, rotation: object, where: str) -> Point:
    """Half the extent, along the world's axes, of a box of this size turned by a quaternion."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    match rotation:
        case {"w": w, "x": x, "y": y, "z": z}:
            if not are_finite(w, x, y, z):
                raise InputError(f"{where}: box rotation is not finite; save the graph again")
        case _:
            return half
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    x, y, z = (sum(abs(a) * h for a, h in zip(row, half, strict=True)) for row in rows)
    return (x, y, z)


def _point(value: object, what: str) -> Point:
    point = as_point(value)
    if point is None:
        raise InputError(f"{what} is not three finite numbers; save the graph again")
    return point
