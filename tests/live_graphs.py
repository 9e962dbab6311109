"""Graphs as a running Hydra sends them, and what labels them. Needs ``spark_dsg``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import spark_dsg

from roomtables.cli.naming import room_namer
from roomtables.online.classifier import RoomTables
from roomtables.online.labeller import Labeller
from roomtables.online.live import GraphLabeller
from roomtables.online.model_thread import ModelThread
from roomtables.online.steady_names import SteadyNames
from roomtables.scenes.live import GraphCodec
from scene_builders import node_id

LABELS = {0: "unknown", 1: "bed", 2: "lamp", 3: "oven", 4: "chair", 5: "fridge"}
BEDROOM, KITCHEN, OFFICE = (1, 2), (3, 5), (4,)


def live_graph(
    *rooms: tuple[int, ...], named: bool = True, labels: Mapping[int, str] = LABELS
) -> Any:
    """A graph whose rooms hold objects of the given labels, alternately through a place."""
    graph = spark_dsg.DynamicSceneGraph()
    if named:
        graph.metadata.set({"labelspaces": {"_l2p0": [[k, v] for k, v in labels.items()]}})
    for index, contents in enumerate(rooms):
        room, place = node_id(f"R{index}"), node_id(f"p{index}")
        attributes = spark_dsg.RoomNodeAttributes()
        attributes.name = f"R{index}"
        graph.add_node("ROOMS", room, attributes)
        graph.add_node("PLACES", place, spark_dsg.PlaceNodeAttributes())
        graph.insert_edge(room, place)
        for number, label in enumerate(contents):
            thing = spark_dsg.ObjectNodeAttributes()
            thing.semantic_label = label
            graph.add_node("OBJECTS", node_id(f"O{100 * index + number}"), thing)
            graph.insert_edge(room if number % 2 else place, node_id(f"O{100 * index + number}"))
    return graph


def names(graph: Any) -> list[str]:
    return [node.attributes.name for node in graph.get_layer("ROOMS").nodes]


def graph_labeller(
    opened: RoomTables,
    model: ModelThread | None = None,
    names: SteadyNames | None = None,
    codec: GraphCodec | None = None,
) -> GraphLabeller:
    """What `serve` labels messages with; names follow every change unless ``names`` says more."""
    names = names or SteadyNames(margin=0, hold=1)
    return GraphLabeller(codec or GraphCodec(), Labeller(opened, model), names, room_namer(opened))


def room_names(message: bytes | None) -> list[str]:
    """The rooms' names in a labelled message."""
    assert message is not None
    return names(spark_dsg.DynamicSceneGraph.from_binary(message))
