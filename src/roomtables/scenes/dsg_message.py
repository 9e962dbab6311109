"""A binary Spark-DSG graph whose rooms are read and named in place.

Of a robot's message only the rooms' names change. So it is not decoded into objects and encoded
again, which takes several times as long: the bytes of the rooms are replaced, and all others go on
as they came, without the mesh. `dsg_layout` tells what lies where.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

from roomtables.errors import InputError
from roomtables.limits import MalformedError, json_value
from roomtables.scenes.dsg_binary import LABEL, CheckedGraph, Entries
from roomtables.scenes.dsg_graph import symbol
from roomtables.scenes.dsg_layout import (
    FEATURE,
    LIST,
    LISTS,
    METADATA,
    NAME,
    PROBABILITIES,
)

_OBJECT_TYPES = frozenset({b"ObjectNodeAttributes", b"KhronosObjectAttributes"})
_ROOM_TYPE = b"RoomNodeAttributes"
_NO_MESH, _NUMBER = b"\xc2", 0xCB
_COUNT, _DOUBLE, _UNSIGNED = struct.Struct("<BI"), struct.Struct("<Bd"), struct.Struct("<I")
# A node's layer, id and partition; an edge's ends; a position.
_Place = tuple[int, int, int]
_PLACE, _ENDS, _POSITION = map(struct.Struct, ("<xqxQxI", "<xQxQ", "<xdxdxd"))
_EMPTY = frozenset({b"{}", b"null"})


def packed_text(text: str) -> bytes:
    """A text as a graph holds it."""
    content = text.encode("utf-8")
    return _COUNT.pack(LISTS[0], len(content)) + content


def packed_probabilities(probabilities: Mapping[str, float]) -> bytes:
    """The probabilities of a room's labels as a graph holds them, ordered by label."""
    pairs = sorted((label.encode("utf-8"), value) for label, value in probabilities.items())
    parts = [_COUNT.pack(LISTS[0], len(pairs))]
    for label, value in pairs:
        parts += _COUNT.pack(LISTS[0], len(label)), label, _DOUBLE.pack(_NUMBER, value)
    return b"".join(parts)


class WrittenRoom(NamedTuple):
    """What is written into a room's node, but for the label as the graph holds it.

    A room keeps what is ``None``.
    """

    name: bytes
    label: int | None = None
    probabilities: bytes | None = None
    metadata: bytes | None = None


class MessageRoom(NamedTuple):
    """A room's node: the name that it bears, its metadata, and where its lists are."""

    name: str
    metadata: dict[str, Any]
    lists: Sequence[tuple[int, int]]


class GraphMessage:
    """The rooms and objects of a binary graph, and what leads from one to the other.

    Attributes
    ----------
    metadata : of the graph
    rooms : by id, of the layer ``ROOMS``
    objects : the label of each object, by id, of the layer ``OBJECTS``; agents may share the layer
        and are no objects
    parents : the nodes in higher layers that each node has an edge with

    Raises
    ------
    InputError
        Metadata is no JSON object, an id occurs twice, or a room's name is no text.
    """

    def __init__(self, checked: CheckedGraph) -> None:
        self._checked, self._data = checked, checked.data
        start, end = checked.metadata
        self.metadata = _metadata(self._data[start + LIST : end], "the graph")
        self.rooms: dict[int, MessageRoom] = {}
        self.objects: dict[int, int] = {}
        layers = self._read_nodes(checked.nodes)
        self.parents = self._read_edges(checked.edges, layers)

    def distance(self, one: int, other: int) -> float:
        """Metres between two nodes."""
        return math.dist(self._positions[one], self._positions[other])

    @cached_property
    def _positions(self) -> dict[int, tuple[float, float, float]]:
        """Where every node is, in metres: hardly a graph needs it."""
        nodes, found = self._checked.nodes, {}
        for span in nodes.spans:
            heads, lists = nodes.heads(self._data, span), nodes.list_spans(self._data, span)
            for head, of in zip(heads, lists, strict=True):
                _, key, _ = _PLACE.unpack(head)
                found[key] = _POSITION.unpack_from(self._data, of[METADATA][1])
        return found

    def with_rooms(
        self, rooms: Mapping[int, WrittenRoom], metadata: dict[str, Any] | None = None
    ) -> bytes:
        """The graph with other values in some rooms, and other metadata if given; without mesh."""
        changes: list[tuple[tuple[int, int], bytes]] = []
        if metadata is not None:
            changes.append((self._checked.metadata, packed_text(json.dumps(metadata))))
        for key, room in rooms.items():
            lists = self.rooms[key].lists
            changes.append((lists[NAME], room.name))
            if room.label is not None:
                at = lists[FEATURE][0]
                changes.append(((at - LABEL, at), _UNSIGNED.pack(room.label)))
            if room.probabilities is not None:
                changes.append((lists[PROBABILITIES], room.probabilities))
            if room.metadata is not None:
                changes.append((lists[METADATA], room.metadata))
        parts, at = list[bytes](), 0
        for (start, end), content in sorted(changes):
            parts += self._data[at:start], content
            at = end
        return b"".join([*parts, self._data[at : self._checked.end], _NO_MESH])

    def _read_nodes(self, nodes: Entries) -> dict[int, int]:
        """Note the rooms and the objects; the layer of every node, by id."""
        layers, count = dict[int, int](), 0
        for span in nodes.spans:
            kind, labels = nodes.types[span.kind], list[bytes]()
            if kind in _OBJECT_TYPES:
                found = nodes.heads_and_labels(self._data, span)
                heads, labels = [head for head, _ in found], [label for _, label in found]
            else:
                heads = nodes.heads(self._data, span)
            places = list(_PLACE.iter_unpack(b"".join(heads)))
            layers.update([(key, layer) for layer, key, _ in places])
            count += len(places)
            if labels:
                self._read_objects(places, labels)
            elif kind == _ROOM_TYPE:
                self._read_rooms(places, nodes.list_spans(self._data, span))
        if len(layers) < count:
            raise InputError("a node's id occurs twice")
        return layers

    def _read_objects(self, places: Iterable[_Place], labels: Iterable[bytes]) -> None:
        wanted = self._checked.layers.get("OBJECTS")
        numbers = _UNSIGNED.iter_unpack(b"".join(labels))
        for (layer, key, partition), (label,) in zip(places, numbers, strict=True):
            if (layer, partition) == wanted:
                self.objects[key] = label

    def _read_rooms(
        self, places: Iterable[_Place], spans: Iterable[Sequence[tuple[int, int]]]
    ) -> None:
        data, wanted = self._data, self._checked.layers.get("ROOMS")
        for (layer, key, partition), lists in zip(places, spans, strict=True):
            if (layer, partition) != wanted:
                continue
            (begin, end), (name_at, name_end) = lists[METADATA], lists[NAME]
            metadata = _metadata(data[begin + LIST : end], f"room {symbol(key)}")
            try:
                name = data[name_at + LIST : name_end].decode("utf-8")
            except UnicodeDecodeError as error:
                raise InputError(f"the name of room {symbol(key)} is no text") from error
            self.rooms[key] = MessageRoom(name, metadata, lists)

    def _read_edges(self, edges: Entries, layers: Mapping[int, int]) -> dict[int, list[int]]:
        """Of an edge's two nodes, the one in the higher layer is the parent."""
        heads = chain.from_iterable(edges.heads(self._data, span) for span in edges.spans)
        parents: dict[int, list[int]] = {}
        for low, high in _ENDS.iter_unpack(b"".join(heads)):
            if low not in layers or high not in layers or layers[low] == layers[high]:
                continue
            if layers[low] > layers[high]:
                low, high = high, low
            above = parents.setdefault(low, [])
            if high not in above:
                above.append(high)
        return parents


def _metadata(content: bytes, what: str) -> dict[str, Any]:
    """Metadata of a graph or a node.

    Raises
    ------
    InputError
        It is no JSON object.
    """
    if content in _EMPTY:
        return {}
    try:
        found = json_value(content)
    except MalformedError as error:
        raise InputError(f"metadata of {what}: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"metadata of {what} is not an object")
    return found
