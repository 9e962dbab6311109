"""A message that is read and named in place, against ``spark_dsg`` and the JSON of the same graph.

``spark_dsg`` decodes and encodes whole graphs, and `dsg` reads and names their JSON: both are
another way to the same end.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from random import Random
from typing import Any

import pytest

from roomtables.errors import InputError
from roomtables.scenes.dsg import NamedRoom, graph_scene, label_rooms
from roomtables.scenes.dsg_graph import parse_graph
from roomtables.scenes.live import GraphCodec, LiveGraph
from roomtables.scenes.scene import ReadOptions

spark_dsg = pytest.importorskip("spark_dsg")

from scene_builders import node_id  # noqa: E402

LABELS = {key: f"thing {key}" for key in range(40)}
OURS = {"roomtables": {"label": "kitchen", "rule": "query"}}


def made_graph(chance: Random) -> Any:
    """Rooms, places and objects with names and metadata of any length, edges criss-cross, agents,
    a mesh, and now and then a label space of the rooms."""
    graph = spark_dsg.DynamicSceneGraph()
    spaces: dict[str, Any] = {"_l2p0": [[key, name] for key, name in LABELS.items()]}
    if chance.random() < 0.5:
        spaces["_l4p0"] = [[0, "unknown"], [3, "kitchen;galley"]]
    graph.metadata.set({"labelspaces": spaces, "note": "é" * chance.randrange(9)})
    rooms = [node_id(f"R{at}") for at in range(chance.randrange(1, 9))]
    places = [node_id(f"p{at}") for at in range(chance.randrange(1, 30))]
    for key in rooms:
        own = spark_dsg.RoomNodeAttributes()
        own.name = chance.choice(("", "R0", "kitchen", "Küche", "x" * 30))
        own.semantic_class_probabilities = chance.choice(({}, {"b": 0.25, "a": 0.75}))
        own.metadata.set(chance.choice(({}, {"k": [1]}, OURS, OURS | {"k": 2})))
        graph.add_node("ROOMS", key, own)
    for key in places:
        own = spark_dsg.PlaceNodeAttributes()
        own.position = [chance.random() for _ in range(3)]
        graph.add_node("PLACES", key, own)
        for room in chance.choices(rooms, k=chance.choice((0, 1, 1, 1, 2))):
            graph.insert_edge(room, key)
    for at in range(chance.randrange(60)):
        kind = chance.choice(("ObjectNodeAttributes", "KhronosObjectAttributes"))
        own, key = getattr(spark_dsg, kind)(), node_id(f"O{at}")
        own.name, own.semantic_label = "x" * chance.randrange(24), chance.randrange(44)
        own.position = [chance.random() for _ in range(3)]
        own.metadata.set(chance.choice(({}, {}, {"k": 1})))
        if kind.startswith("Object"):
            own.mesh_connections = chance.choice(([], [1, 2]))
        graph.add_node("OBJECTS", key, own)
        for above in chance.sample([*places, *rooms], chance.choice((0, 1, 1, 1, 2))):
            graph.insert_edge(above, key)
    return graph


def document_of(graph: Any, folder: Path) -> dict[str, Any]:
    path = folder / "graph.json"
    graph.save(path, False)
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def in_order(document: dict[str, Any]) -> dict[str, Any]:
    """A document whose nodes and edges are ordered: ``spark_dsg`` need not keep their order."""
    nodes = sorted(document["nodes"], key=lambda node: node["id"])
    edges = sorted(document["edges"], key=lambda edge: (edge["source"], edge["target"]))
    return document | {"nodes": nodes, "edges": edges}


def decoded(graph: Any) -> LiveGraph:
    return GraphCodec().decode(graph.to_binary(include_mesh=False))


@pytest.mark.parametrize("seed", range(40))
def test_rooms_hold_what_the_json_of_the_graph_says(seed: int, tmp_path: Path) -> None:
    graph = made_graph(Random(seed))
    options = ReadOptions(warn=lambda line: None)
    scene = graph_scene(parse_graph(document_of(graph, tmp_path), "graph"), "graph", options)
    live = decoded(graph)
    expected = {room.room_id: sorted(thing.name for thing in room.objects) for room in scene.rooms}
    assert {key: list(found) for key, found in live.rooms.items()} == expected
    assert live.names == {room.room_id: room.name for room in scene.rooms}


@pytest.mark.parametrize("seed", range(40))
def test_only_what_names_a_room_changes(seed: int, tmp_path: Path) -> None:
    """The graph that goes on is the one that naming the rooms of its JSON makes."""
    chance = Random(seed)
    graph = made_graph(chance)
    live = decoded(graph)
    assert decoded(graph).encode() == graph.to_binary(include_mesh=False)
    named: dict[str, NamedRoom | None] = {
        key: NamedRoom("bath room", {"bath room": 0.75, "kitchen": 0.25}, {"rule": "query"})
        for key in live.rooms
        if chance.random() < 0.5
    }
    expected = document_of(graph, tmp_path)
    label_rooms(
        parse_graph(expected, "graph"),
        {key: room for key, room in named.items() if room is not None},
        ["kitchen", "bath room"],
    )
    named |= dict.fromkeys(live.ours - named.keys())
    live.name_rooms(named, ["kitchen", "bath room"])
    labelled = spark_dsg.DynamicSceneGraph.from_binary(live.encode())
    assert in_order(document_of(labelled, tmp_path)) == in_order(expected)


def test_the_mesh_stays_behind() -> None:
    graph = made_graph(Random(1))
    mesh = spark_dsg.Mesh()
    mesh.set_vertices([[0.0] * 2] * 6)
    graph.mesh = mesh
    with_mesh = graph.to_binary(include_mesh=True)
    assert len(with_mesh) > len(graph.to_binary(include_mesh=False))
    assert GraphCodec().decode(with_mesh).encode() == graph.to_binary(include_mesh=False)


def test_what_cannot_be_named_is_told() -> None:
    graph = made_graph(Random(2))
    graph.get_node(node_id("R0")).attributes.name = "KITCHEN"
    message = graph.to_binary(include_mesh=False)
    with pytest.raises(InputError, match="the name of room R0 is no text"):
        GraphCodec().decode(message.replace(b"KITCHEN", b"\xff\xfeKITCH"[:7]))
    twice = message.replace(struct.pack("<Q", node_id("p0")), struct.pack("<Q", node_id("R0")))
    with pytest.raises(InputError, match="a node's id occurs twice"):
        GraphCodec().decode(twice)
