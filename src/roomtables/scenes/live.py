"""Messages of a running robot: graphs of the package ``spark_dsg``, read, named and sent on.

Needs the extra ``scene-graphs``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, MissingExtraError, first_line
from roomtables.scenes.dsg import (
    HYDRA,
    OURS,
    NamedRoom,
    name_origin,
    room_label_space,
    unknown_room,
)
from roomtables.scenes.dsg_binary import check_graph
from roomtables.scenes.dsg_graph import label_spaces, rooms_of, symbol
from roomtables.scenes.dsg_message import (
    GraphMessage,
    MessageRoom,
    WrittenRoom,
    packed_probabilities,
    packed_text,
)
from roomtables.scenes.hydra import load_label_names

_OLDEST = (1, 1)  # whose messages are read in place
_UNSET_LABEL = 2**32 - 1  # a node's semantic_label has 32 bits


class LiveGraph:
    """One message.

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

    def __init__(self, message: GraphMessage, names: Mapping[int, str] | None) -> None:
        self._message = message
        spaces = label_spaces({"metadata": message.metadata}, "message")
        self._room_labels = _checked_labels(spaces.get("_l4p0", {}))
        names = names or spaces.get("_l2p0") or spaces.get("mesh")
        if names is None and message.objects and message.rooms:
            raise InputError(
                "no label space names its objects' labels; give one with `--labelspace FILE.yaml`"
            )
        self._keys = {symbol(key): key for key in message.rooms}
        self.rooms = self._contents(names or {})
        self.names = {key: self._room(key).name for key in self._keys}
        origins = {
            key: name_origin(name, _child(self._room(key).metadata, "roomtables"))
            for key, name in self.names.items()
        }
        self.unnamed = frozenset(key for key, origin in origins.items() if origin == HYDRA)
        self.ours = frozenset(key for key, origin in origins.items() if origin == OURS)
        self._written: dict[int, WrittenRoom] = {}
        self._metadata: dict[str, Any] | None = None  # of the graph, where it changes

    def _room(self, key: str) -> MessageRoom:
        return self._message.rooms[self._keys[key]]

    def _contents(self, names: Mapping[int, str]) -> dict[str, tuple[str, ...]]:
        message = self._message
        owner = rooms_of(
            message.objects,
            lambda key: message.parents.get(key, ()),
            message.rooms.__contains__,
            message.distance,
        )
        held: dict[int, list[str]] = {key: [] for key in message.rooms}
        for key, room in owner.items():
            name = names.get(message.objects[key])
            if room is not None and name is not None:
                held[room].append(name)
        return {key: tuple(sorted(held[room])) for key, room in self._keys.items()}

    def name_rooms(self, named: Mapping[str, NamedRoom | None], labels: Iterable[str]) -> None:
        """Write names into the graph; ``None`` gives a room back the one that its id stands for.

        Rooms that are not among ``named`` keep what they have.
        """
        used = {room.label for room in named.values() if room is not None}
        ids, pairs = room_label_space(self._room_labels, used, labels)
        if used and len(pairs) > len(self._room_labels):
            metadata = self._message.metadata
            spaces = {**_child(metadata, "labelspaces"), "_l4p0": pairs}
            self._metadata = {**metadata, "labelspaces": spaces}
        for key, room in named.items():
            if room is not None:
                self._written[self._keys[key]] = self._named(key, room, ids[room.label])
            else:
                self._written[self._keys[key]] = self._unnamed(key)

    def _named(self, key: str, room: NamedRoom, label: int) -> WrittenRoom:
        written, own = room.packed._replace(label=label), self._room(key).metadata
        if not own:
            return written
        noted = json.dumps({**own, "roomtables": dict(room.provenance)})
        return written._replace(metadata=packed_text(noted))

    def _unnamed(self, key: str) -> WrittenRoom:
        if key not in self.ours:  # Hydra copied the name, and all the rest is its own
            return WrittenRoom(packed_text(key))
        own = {k: v for k, v in self._room(key).metadata.items() if k != "roomtables"}
        label = unknown_room(self._room_labels)
        noted = packed_text(json.dumps(own))
        return WrittenRoom(packed_text(key), label, packed_probabilities({}), noted)

    def encode(self) -> bytes:
        """The message to publish, without the mesh."""
        return self._message.with_rooms(self._written, self._metadata)


class GraphCodec:
    """Reads messages, with the names of a Hydra label-space YAML where one is given.

    Messages do not tell which ``spark_dsg`` wrote them: it must be the one that is installed here.

    Raises
    ------
    InputError
        The YAML is not a label space, or ``spark_dsg`` is too old.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """

    def __init__(self, labelspace: Path | None = None) -> None:
        self._names = load_label_names(labelspace) if labelspace else None
        try:
            installed = version("spark-dsg")
        except PackageNotFoundError as error:
            raise MissingExtraError("a running robot's scene graph", "scene-graphs") from error
        self._version = tuple(map(int, installed.split(".")[:3]))
        if self._version < _OLDEST:
            raise InputError(
                f"spark-dsg {installed} is too old for live graphs; type `pip install -U spark-dsg`"
            )

    def decode(self, message: bytes) -> LiveGraph:
        """A graph from a message.

        Raises
        ------
        InputError
            The message is no scene graph, or one whose labels nothing names.
        """
        try:
            return LiveGraph(GraphMessage(check_graph(message, self._version)), self._names)
        except InputError:
            raise
        except Exception as error:  # whatever a forged message makes of the reader
            raise InputError(f"not a readable scene graph ({first_line(error)})") from error


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
