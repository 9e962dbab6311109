"""Whatever a message holds, it is labelled or dropped, and the next graph is labelled."""

from __future__ import annotations

import json
import logging
import random
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from roomtables.online.classifier import RoomTables
from roomtables.online.complaints import Complaints
from roomtables.online.live import GraphLabeller
from roomtables.online.steady_names import SteadyNames
from tiny_tables import build_tables

spark_dsg = pytest.importorskip("spark_dsg")
yaml = pytest.importorskip("yaml")

from live_graphs import (  # noqa: E402
    BEDROOM,
    KITCHEN,
    LABELS,
    OFFICE,
    graph_labeller,
    live_graph,
    room_names,
)
from roomtables.scenes.live import GraphCodec  # noqa: E402

GOOD = live_graph(OFFICE, BEDROOM).to_binary()


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> RoomTables:
    tables = build_tables(tmp_path_factory.mktemp("built"))
    return RoomTables.open(tables, "flat", offline=True, note_misses=False)


@pytest.fixture(scope="module")
def graphs(opened: RoomTables, tmp_path_factory: pytest.TempPathFactory) -> GraphLabeller:
    """With a label-space YAML, so that what the graphs say of label spaces may be damaged."""
    path = tmp_path_factory.mktemp("names") / "labels.yaml"
    names = [{"label": key, "name": name} for key, name in LABELS.items()]
    path.write_text(yaml.safe_dump({"label_names": names}))
    return graph_labeller(opened, names=SteadyNames(0, 1, keep_names=True), codec=GraphCodec(path))


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The JSON of a labelled graph, in which everything that is written occurs."""
    path = tmp_path_factory.mktemp("graph") / "graph.json"
    graph = live_graph(KITCHEN, BEDROOM, ())
    spaces = {"_l2p0": [[k, v] for k, v in LABELS.items()], "_l4p0": [[0, "unknown"], [1, "bar"]]}
    graph.metadata.set({"labelspaces": spaces})
    room = next(iter(graph.get_layer("ROOMS").nodes)).attributes
    room.name, room.semantic_class_probabilities = "kitchen", {"kitchen": 1.0}
    room.metadata.set({"roomtables": {"label": "kitchen", "rule": "query"}})
    graph.save(path)
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def outcome(graphs: GraphLabeller, message: bytes) -> str:
    """Whether a message is labelled or dropped; then a good one must be labelled."""
    dropped = graphs.counters.dropped
    labelled = graphs.take(message)
    assert (labelled is None) == (graphs.counters.dropped == dropped + 1)
    assert room_names(graphs.take(GOOD)) == ["office", "bedroom"]
    return "dropped" if labelled is None else "labelled"


def encoded(document: dict[str, Any], folder: Path) -> bytes | None:
    """The message of a graph's JSON; None where ``spark_dsg`` itself refuses it."""
    path = folder / "graph.json"
    path.write_text(json.dumps(document))
    try:
        message: bytes = spark_dsg.DynamicSceneGraph.load(path).to_binary()
    except Exception:
        return None
    return message


def room_of(document: dict[str, Any]) -> dict[str, Any]:
    rooms = (node for node in document["nodes"] if node["attributes"]["name"] == "kitchen")
    found: dict[str, Any] = next(rooms)
    return found


def set_metadata(value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda graph: room_of(graph)["attributes"].update(metadata=value)


def set_room_labels(value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda graph: graph["metadata"]["labelspaces"].update(_l4p0=value)


@pytest.mark.parametrize(
    "damage",
    [
        set_metadata([1]),
        set_metadata("kitchen"),
        set_metadata({"roomtables": [1]}),
        set_room_labels([[4294967295, "bar"]]),
        set_room_labels([[-5, "bar"]]),
        set_room_labels([[10**18, "bar"]]),
        set_room_labels("bar"),
        set_room_labels([[1, "bar", 2]]),
        lambda graph: graph["metadata"].update(labelspaces=[1]),
        lambda graph: graph["metadata"].update(labelspaces="none"),
        lambda graph: graph.update(metadata=[1]),
    ],
)
def test_malformed_metadata_drops_the_message(
    graphs: GraphLabeller, document: dict[str, Any], damage: Any, tmp_path: Path
) -> None:
    """Fault A1: each of these ended the service."""
    damaged = json.loads(json.dumps(document))
    damage(damaged)
    message = encoded(damaged, tmp_path)
    assert message is not None
    assert outcome(graphs, message) == "dropped"


def test_odd_geometry_and_edges_do_no_harm(graphs: GraphLabeller, tmp_path: Path) -> None:
    """Positions that are no numbers, a room without end in either direction, an edge to itself."""
    graph = live_graph(KITCHEN, BEDROOM)
    rooms, things = list(graph.get_layer("ROOMS").nodes), list(graph.get_layer("OBJECTS").nodes)
    rooms[0].attributes.position = [float("nan"), float("inf"), -1e308]
    for place in graph.get_layer("PLACES").nodes:  # every object in several rooms
        place.attributes.position = [float("nan")] * 3
        for thing in things:
            graph.insert_edge(place.id.value, thing.id.value)
    graph.insert_edge(rooms[0].id.value, rooms[0].id.value)
    graph.insert_edge(rooms[0].id.value, rooms[1].id.value)
    for thing, label in zip(things, (2**32 - 1, 2**31, 0, 5), strict=False):
        thing.attributes.semantic_label = label
    assert outcome(graphs, graph.to_binary()) == "labelled"


def test_a_long_chain_of_places_drops_the_message(graphs: GraphLabeller) -> None:
    graph = live_graph(KITCHEN)
    first, *_ = graph.get_layer("PLACES").nodes
    before = first.id.value
    for _ in range(5000):
        graph.add_node("PLACES", before + 1, spark_dsg.PlaceNodeAttributes())
        graph.insert_edge(before, before + 1)
        before += 1
    thing = spark_dsg.ObjectNodeAttributes()
    graph.add_node("OBJECTS", ord("O") << 56 | 77_777, thing)
    graph.insert_edge(before, ord("O") << 56 | 77_777)
    outcome(graphs, graph.to_binary())


VALUES: tuple[Any, ...] = (
    None, True, -5, 0, 1, 4294967295, 2**63, -(2**63), 10**400, 1e308, 0.5, "", "x", "kitchen",
    "\x1b]0;title\x07", "R0", "é" * 300, [], [1], [[]], {}, {"a": 1}, [[1, "a"]], [["1", 2]],
)  # fmt: skip


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container in a document, with each of its keys."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, child in list(items):
        yield value, key
        if isinstance(child, dict | list):
            yield from places(child)


@pytest.mark.parametrize("count", [200, pytest.param(3000, marks=pytest.mark.slow)])
def test_structured_mutations_never_end_it(
    graphs: GraphLabeller, document: dict[str, Any], tmp_path: Path, count: int
) -> None:
    """Types swapped, keys dropped, entries doubled, numbers enormous."""
    chance, outcomes, text = random.Random(13), [], json.dumps(document)
    for _ in range(count):
        mutated = json.loads(text)
        for _ in range(chance.choice((1, 1, 2))):
            holder, key = chance.choice(list(places(mutated)))
            action = chance.random()
            if action < 0.7:
                holder[key] = chance.choice(VALUES)
            elif action < 0.85:
                del holder[key]
            elif isinstance(holder, list):
                holder.append(json.loads(json.dumps(holder[key])))
        message = encoded(mutated, tmp_path)
        if message is not None:
            outcomes.append(outcome(graphs, message))
    assert outcomes.count("dropped") > count // 30
    assert outcomes.count("labelled") > count // 6


def test_damaged_bytes_never_end_it(graphs: GraphLabeller) -> None:
    chance = random.Random(7)
    message = live_graph(KITCHEN, BEDROOM).to_binary()
    numbers = [struct.pack(">I", n) for n in (0, 1, 2**31 - 1, 2**32 - 1)]
    for _ in range(1500):
        damaged = bytearray(message)
        for _ in range(chance.choice((1, 2, 5))):
            at = chance.randrange(len(damaged) - 4)
            damaged[at : at + 4] = chance.choice([*numbers, chance.randbytes(4)])
        outcome(graphs, bytes(damaged[: chance.choice((len(damaged), chance.randrange(9999)))]))


def test_a_flood_is_one_line_a_kind_and_second(caplog: pytest.LogCaptureFixture) -> None:
    now = 0.0
    complain = Complaints(clock=lambda: now)
    for at in range(640):  # 64 a second, of two kinds
        complain(f"node {at} is odd, and {at}", "dropped: {}")
        complain("something else is odd")
        now += 1 / 64
    told = [record.getMessage() for record in caplog.records]
    assert sum("node" in line for line in told) == sum("else" in line for line in told) == 10
    assert told[0] == "dropped: node 0 is odd, and 0"
    assert told[-1].endswith("(and 63 more like it)")


def test_reasons_that_never_repeat_are_few_lines_too(caplog: pytest.LogCaptureFixture) -> None:
    complain = Complaints(clock=lambda: 0.0)
    chance = random.Random(3)
    for _ in range(2000):
        complain("".join(chance.choices("abcdefgh ", k=200)))
    complain("x" * 10_000_000)
    assert len([r for r in caplog.records if r.name.endswith("complaints")]) <= 51
    assert max(len(record.getMessage()) for record in caplog.records) < 400


def test_dropping_costs_no_lasting_memory_of_the_message(
    graphs: GraphLabeller, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    started = time.monotonic()
    for at in range(200):
        graphs.take(b"nonsense %d" % at)
    assert caplog.text.count("dropped a message") <= 2 + time.monotonic() - started
