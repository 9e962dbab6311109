"""Spark-DSG's binary form, in files and in messages, through the package ``spark_dsg``.

A file is read and written by way of the JSON that ``spark_dsg`` itself writes for it, so that
`dsg` and `dsg_graph` serve both forms. A message of a running robot stays a graph of ``spark_dsg``,
without the detour by JSON. Needs the extra ``scene-graphs``.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, first_line, needing
from roomtables.limits import SCENE_BYTES, json_value, read_bytes
from roomtables.scenes.dsg import NamedRoom, graph_scene, room_label_space
from roomtables.scenes.dsg_binary import check_graph
from roomtables.scenes.dsg_graph import label_spaces, parse_graph, rooms_of, symbol
from roomtables.scenes.hydra import load_label_names
from roomtables.scenes.scene import ReadOptions, Scene
from roomtables.scenes.scene_file import SceneFile

# A node's id is a letter above these bits, and an index.
_INDEX_BITS = 56
_OBJECT_LETTERS = frozenset(map(ord, "Oo"))


def is_sparkdsg(file: SceneFile) -> bool:
    """Whether a file has the header of a binary Spark-DSG graph; its JSON has one as well."""
    return b"SPARK_DSG" in file.head[:32] and not file.is_json


def read_sparkdsg(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from a ``.sparkdsg`` file, read without its mesh.

    Raises
    ------
    InputError, MissingExtraError
        As `sparkdsg_document`, or as reading the same graph from JSON.
    """
    document = sparkdsg_document(file.path, include_mesh=False)
    return graph_scene(parse_graph(document, str(file.path)), file.path.stem, options)


def sparkdsg_document(path: Path, *, include_mesh: bool) -> dict[str, Any]:
    """The JSON of a ``.sparkdsg`` file.

    Raises
    ------
    InputError
        The file is damaged, or of a version that the installed ``spark_dsg`` cannot read.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    loader = _graph_class()
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / "graph.sparkdsg"
        name.symlink_to(path.resolve())  # spark_dsg goes by the suffix
        try:
            check_graph(read_bytes(path, SCENE_BYTES), None)
            graph = loader.load(name)
            graph.save(Path(folder) / "graph.json", include_mesh)
            document: dict[str, Any] = json_value((Path(folder) / "graph.json").read_bytes())
        except Exception as error:
            raise InputError(
                f"{path}: not a readable .sparkdsg file ({first_line(error)}); save the graph again"
            ) from error
    return document


def write_sparkdsg(document: dict[str, Any], path: Path) -> None:
    """Write a graph's JSON as a ``.sparkdsg`` file.

    Raises
    ------
    InputError
        ``spark_dsg`` cannot load the graph.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    loader = _graph_class()
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / "graph.json"
        name.write_text(json.dumps(document), encoding="utf-8")
        try:
            loader.load(name).save(path, True)
        except Exception as error:
            raise InputError(
                f"spark_dsg cannot load the graph ({first_line(error)}); write .json"
            ) from error


def _graph_class() -> Any:
    """``spark_dsg.DynamicSceneGraph``."""
    with needing("a .sparkdsg scene graph"):
        from spark_dsg import DynamicSceneGraph

    return DynamicSceneGraph


class LiveGraph:
    """One decoded message. ``rooms`` maps each room's symbol to the labels of its objects."""

    def __init__(self, graph: Any, names: Mapping[int, str] | None) -> None:
        self._graph = graph
        metadata = dict(graph.metadata.get())
        spaces = label_spaces({"metadata": metadata}, "message")
        self._rooms = {symbol(node.id.value): node for node in _nodes(graph, "ROOMS")}
        self._room_labels = spaces.get("_l4p0", {})
        names = names or spaces.get("_l2p0") or spaces.get("mesh")
        objects = _object_labels(graph)
        if names is None and objects and self._rooms:
            raise InputError(
                "no label space names its objects' labels; give one with `--labelspace FILE.yaml`"
            )
        self.rooms = self._contents(objects, names or {})

    def _contents(
        self, objects: Mapping[int, int], names: Mapping[int, str]
    ) -> dict[str, tuple[str, ...]]:
        graph = self._graph
        rooms = {node.id.value: key for key, node in self._rooms.items()}
        parents = _parents_below(graph, rooms)
        owner = rooms_of(
            objects,
            lambda key: parents.get(key, ()),
            rooms.__contains__,
            lambda child, parent: math.dist(graph.get_position(child), graph.get_position(parent)),
        )
        held: dict[str, list[str]] = {key: [] for key in self._rooms}
        for key, room in owner.items():
            name = names.get(objects[key])
            if room is not None and name is not None:
                held[rooms[room]].append(name)
        return {key: tuple(sorted(found)) for key, found in held.items()}

    def name_rooms(self, named: Mapping[str, NamedRoom], labels: Iterable[str]) -> None:
        """Write names into the graph; rooms without an answer keep what they have."""
        used = {room.label for room in named.values()}
        ids, pairs = room_label_space(self._room_labels, used, labels)
        if named and len(pairs) > len(self._room_labels):
            metadata = dict(self._graph.metadata.get())
            metadata.setdefault("labelspaces", {})["_l4p0"] = pairs
            self._graph.metadata.set(metadata)
        for key, room in named.items():
            attributes = self._rooms[key].attributes
            attributes.name = room.label
            attributes.semantic_label = ids[room.label]
            attributes.semantic_class_probabilities = dict(room.probabilities)
            own = dict(attributes.metadata.get())
            attributes.metadata.set({**own, "roomtables": dict(room.provenance)})

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
        self._graph_class = _graph_class()
        self._version = tuple(map(int, version("spark-dsg").split(".")[:3]))

    def decode(self, message: bytes) -> LiveGraph:
        """A graph from a message.

        Raises
        ------
        InputError
            The message is no scene graph, or one whose labels nothing names.
        """
        try:
            check_graph(message, self._version)
            graph = self._graph_class.from_binary(message)
            return LiveGraph(graph, self._names)
        except InputError:
            raise
        except Exception as error:  # whatever a forged message makes of the decoder
            raise InputError(f"not a readable scene graph ({first_line(error)})") from error


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


def _object_labels(graph: Any) -> dict[int, int]:
    """The label of each object, by id; agents may share the layer and are no objects."""
    labels = {}
    for node in _nodes(graph, "OBJECTS"):
        attributes = node.attributes
        if "Object" in type(attributes).__name__:
            labels[node.id.value] = attributes.semantic_label
    return labels
