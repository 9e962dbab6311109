"""Messages of a running robot: graphs of the package ``spark_dsg``, read, named and sent on.

A message stays a graph of ``spark_dsg``, without the detour by JSON that files take. Needs the
extra ``scene-graphs``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, first_line
from roomtables.scenes.dsg import (
    HYDRA,
    OURS,
    NamedRoom,
    name_origin,
    room_label_space,
    unknown_room,
)
from roomtables.scenes.dsg_binary import CheckedGraph, check_graph
from roomtables.scenes.dsg_graph import label_spaces, rooms_of, symbol
from roomtables.scenes.hydra import load_label_names
from roomtables.scenes.sparkdsg import graph_class

# A node's id is a letter above these bits, and an index.
_INDEX_BITS = 56
_OBJECT_LETTERS = frozenset(map(ord, "Oo"))
_NO_METADATA = frozenset({"null", "{}"})
_UNSET_LABEL = 2**32 - 1  # a node's semantic_label has 32 bits


class LiveGraph:
    """One decoded message.

    Attributes
    ----------
    rooms : each room's symbol (``R0``), and the labels of its objects
    names : the name that each room bears
    unnamed : the rooms that bear none but Hydra's, which stands for their id
    ours : the rooms whose name is from roomtables, as their metadata tells

    Raises
    ------
    InputError
        No label space names the objects, or metadata or a label space is malformed.
    """

    def __init__(self, graph: Any, names: Mapping[int, str] | None, checked: CheckedGraph) -> None:
        self._graph = graph
        self._metadata = _metadata(graph, "the graph")
        spaces = label_spaces({"metadata": self._metadata}, "message")
        self._room_labels = _checked_labels(spaces.get("_l4p0", {}))
        names = names or spaces.get("_l2p0") or spaces.get("mesh")
        nodes = {node.id.value: node for node in _nodes(graph, "ROOMS")}
        self._rooms = {symbol(key): node.attributes for key, node in nodes.items()}
        objects = _object_labels(graph, checked)
        if names is None and objects and self._rooms:
            raise InputError(
                "no label space names its objects' labels; give one with `--labelspace FILE.yaml`"
            )
        self.rooms = self._contents(
            dict(zip(nodes, self._rooms, strict=True)), objects, names or {}
        )
        self.names = {key: str(attributes.name) for key, attributes in self._rooms.items()}
        self._room_metadata = {
            key: _metadata(attributes, f"room {key}") for key, attributes in self._rooms.items()
        }
        origins = {
            key: name_origin(name, _child(self._room_metadata[key], "roomtables"))
            for key, name in self.names.items()
        }
        self.unnamed = frozenset(key for key, origin in origins.items() if origin == HYDRA)
        self.ours = frozenset(key for key, origin in origins.items() if origin == OURS)

    def _contents(
        self, rooms: Mapping[int, str], objects: Mapping[int, int], names: Mapping[int, str]
    ) -> dict[str, tuple[str, ...]]:
        graph = self._graph
        parents = _parents_below(graph, rooms)
        owner = rooms_of(
            objects,
            lambda key: parents.get(key, ()),
            rooms.__contains__,
            lambda child, parent: math.dist(graph.get_position(child), graph.get_position(parent)),
        )
        held: dict[str, list[str]] = {key: [] for key in rooms.values()}
        for key, room in owner.items():
            name = names.get(objects[key])
            if room is not None and name is not None:
                held[rooms[room]].append(name)
        return {key: tuple(sorted(found)) for key, found in held.items()}

    def name_rooms(self, named: Mapping[str, NamedRoom | None], labels: Iterable[str]) -> None:
        """Write names into the graph; ``None`` gives a room back the one that its id stands for.

        Rooms that are not among ``named`` keep what they have.
        """
        used = {room.label for room in named.values() if room is not None}
        ids, pairs = room_label_space(self._room_labels, used, labels)
        if used and len(pairs) > len(self._room_labels):
            spaces = {**_child(self._metadata, "labelspaces"), "_l4p0": pairs}
            self._graph.metadata.set({**self._metadata, "labelspaces": spaces})
        for key, room in named.items():
            attributes, own = self._rooms[key], self._room_metadata[key]
            if room is not None:
                attributes.name = room.label
                attributes.semantic_label = ids[room.label]
                attributes.semantic_class_probabilities = dict(room.probabilities)
                _note_provenance(attributes, own, room)
                continue
            attributes.name = key
            if key in self.ours:  # else Hydra copied the name, and all the rest is its own
                attributes.semantic_label = unknown_room(self._room_labels)
                attributes.semantic_class_probabilities = {}
                attributes.metadata.set({k: v for k, v in own.items() if k != "roomtables"})

    def encode(self) -> bytes:
        """The message to publish, without the mesh."""
        message: bytes = self._graph.to_binary(include_mesh=False)
        return message


class GraphCodec:
    """Decodes messages, with the names of a Hydra label-space YAML where one is given.

    Raises
    ------
    InputError
        The YAML is not a label space.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """

    def __init__(self, labelspace: Path | None = None) -> None:
        self._names = load_label_names(labelspace) if labelspace else None
        self._graph_class = graph_class()
        self._version = tuple(map(int, version("spark-dsg").split(".")[:3]))

    def decode(self, message: bytes) -> LiveGraph:
        """A graph from a message.

        Raises
        ------
        InputError
            The message is no scene graph, or one whose labels nothing names.
        """
        try:
            checked = check_graph(message, self._version)
            graph = self._graph_class.from_binary(message)
            return LiveGraph(graph, self._names, checked)
        except InputError:
            raise
        except Exception as error:  # whatever a forged message makes of the decoder
            raise InputError(f"not a readable scene graph ({first_line(error)})") from error


def _metadata(holder: Any, what: str) -> dict[str, Any]:
    """The metadata of a graph or of a node's attributes.

    Raises
    ------
    InputError
        It is no JSON object.
    """
    try:
        if holder._metadata._get() in _NO_METADATA:  # most nodes' is: spares decoding it
            return {}
    except AttributeError:  # it is private, and may be named otherwise one day
        pass
    try:
        return dict(holder.metadata.get())
    except TypeError as error:  # spark_dsg wraps what it holds as a mapping, whatever it is
        raise InputError(f"metadata of {what} is not an object") from error


def _note_provenance(attributes: Any, own: Mapping[str, Any], room: NamedRoom) -> None:
    """Add where a room's name came from to the metadata that the room has."""
    try:
        if not own:  # spares encoding what is in most graphs the same as in the one before
            attributes._metadata._set(room.metadata)
            return
    except AttributeError:  # as in `_metadata`
        pass
    attributes.metadata.set({**own, "roomtables": dict(room.provenance)})


def _child(value: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The object under a key, empty where there is none.

    Raises
    ------
    InputError
        What is there is no JSON object.
    """
    child = value.get(key) or {}
    if not isinstance(child, Mapping):
        raise InputError(f"metadata holds {key} that is not an object")
    return child


def _checked_labels(names: dict[int, str]) -> dict[int, str]:
    """A room label space, if each id fits a node's ``semantic_label`` and leaves room for more."""
    for key in names:
        if not 0 <= key < _UNSET_LABEL:
            raise InputError(f"label space of the rooms holds the id {key}; ids go from 0 to 2³²−2")
    return names


def _nodes(graph: Any, layer: str) -> Iterable[Any]:
    nodes: Iterable[Any] = graph.get_layer(layer).nodes if graph.has_layer(layer) else ()
    return nodes


def _parents_below(graph: Any, rooms: Iterable[int]) -> dict[int, list[int]]:
    """The parents of all that lies below the rooms: few nodes are asked, as most are objects."""
    parents: dict[int, list[int]] = {}
    asked, todo = set(rooms), list(rooms)
    while todo:
        parent = todo.pop()
        for child in graph.get_node(parent).children():
            parents.setdefault(child, []).append(parent)
            if child not in asked and child >> _INDEX_BITS not in _OBJECT_LETTERS:
                asked.add(child)
                todo.append(child)
    return parents


def _object_labels(graph: Any, checked: CheckedGraph) -> dict[int, int]:
    """The label of each object, by id; agents may share the layer and are no objects."""
    if not graph.has_layer("OBJECTS"):
        return {}
    layer = graph.get_layer("OBJECTS")
    labels = checked.object_labels(layer.key.layer, layer.key.partition)
    if len(labels) == layer.num_nodes():  # else spark_dsg tells, which takes longer
        return labels
    labels = {}
    for node in layer.nodes:
        attributes = node.attributes
        if "Object" in type(attributes).__name__:
            labels[node.id.value] = attributes.semantic_label
    return labels
