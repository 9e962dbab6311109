"""serve against real senders and receivers of ``spark_dsg`` on loopback."""

from __future__ import annotations

import logging
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from roomtables.cli.common import Namer
from roomtables.errors import InputError, ModelError
from roomtables.online.classifier import RoomTables
from roomtables.online.serve import Counters, Labeller, Service
from scene_builders import node_id
from tiny_tables import FitScorer, build_tables

spark_dsg = pytest.importorskip("spark_dsg")
spark_dsg_zmq = pytest.importorskip("spark_dsg.zmq")
zmq = pytest.importorskip("zmq")

from roomtables.scenes.sparkdsg import GraphCodec  # noqa: E402

LABELS = {0: "unknown", 1: "bed", 2: "lamp", 3: "oven", 4: "chair", 5: "fridge"}
BEDROOM, KITCHEN, OFFICE = (1, 2), (3, 5), (4,)


def live_graph(*rooms: tuple[int, ...], named: bool = True) -> Any:
    """A graph whose rooms hold objects of the given labels, alternately through a place."""
    graph = spark_dsg.DynamicSceneGraph()
    if named:
        graph.metadata.set({"labelspaces": {"_l2p0": [[k, v] for k, v in LABELS.items()]}})
    for index, labels in enumerate(rooms):
        room, place = node_id(f"R{index}"), node_id(f"p{index}")
        attributes = spark_dsg.RoomNodeAttributes()
        attributes.name = f"R{index}"
        graph.add_node("ROOMS", room, attributes)
        graph.add_node("PLACES", place, spark_dsg.PlaceNodeAttributes())
        graph.insert_edge(room, place)
        for number, label in enumerate(labels):
            thing = spark_dsg.ObjectNodeAttributes()
            thing.semantic_label = label
            graph.add_node("OBJECTS", node_id(f"O{100 * index + number}"), thing)
            graph.insert_edge(room if number % 2 else place, node_id(f"O{100 * index + number}"))
    return graph


def names(graph: Any) -> list[str]:
    return [node.attributes.name for node in graph.get_layer("ROOMS").nodes]


def free_url() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_tables(tmp_path_factory.mktemp("built"))


@pytest.fixture(scope="module")
def opened(tables: Path) -> RoomTables:
    return RoomTables.open(tables, "flat", offline=True)


class Wire:
    """A service between a real sender and a real receiver, in a thread of its own."""

    def __init__(self, opened: RoomTables, with_model: RoomTables | None = None) -> None:
        self.recv, self.send = free_url(), free_url()
        self.context = zmq.Context()

        namer = Namer(opened)

        def name(graph: Any, answers: Any) -> None:
            graph.name_rooms(namer(answers), ["bedroom", "kitchen", "office"])

        labeller = Labeller(opened, with_model)
        self.service = Service(GraphCodec(), labeller, name, self.recv, self.send)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.service.run, args=(self.stop, 0.2), daemon=True)
        self.thread.start()
        self.receiver = spark_dsg_zmq.DsgReceiver(self.send, context=self.context)
        self.sender = self.new_sender()

    def new_sender(self) -> Any:
        return spark_dsg_zmq.DsgSender(self.recv, context=self.context)

    def until(self, wanted: Callable[[Any], bool], message: Any) -> Any:
        """Send a graph (or bytes) again and again until the published graph is as wanted."""
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            if isinstance(message, bytes):
                self.sender._socket.send(message)
            else:
                self.sender.send(message)
            if self.receiver.recv(100) and wanted(self.receiver.graph):
                return self.receiver.graph
        raise AssertionError(f"never published; {self.service.counters.line()}")

    def until_dropped(self, message: bytes) -> None:
        """Send a message again and again until the service has dropped it."""
        before, deadline = self.service.counters.dropped, time.monotonic() + 20
        while self.service.counters.dropped == before and time.monotonic() < deadline:
            self.sender._socket.send(message)
            time.sleep(0.02)
        assert self.service.counters.dropped > before

    def close(self) -> None:
        self.stop.set()
        self.thread.join(10)
        self.service.close()
        self.context.destroy(linger=0)
        assert not self.thread.is_alive()


@pytest.fixture
def wire(opened: RoomTables) -> Iterator[Wire]:
    wire = Wire(opened)
    yield wire
    wire.close()


def test_rooms_come_back_named_and_everything_else_as_it_was(wire: Wire) -> None:
    graph = live_graph(BEDROOM, KITCHEN, ())
    found = wire.until(lambda g: names(g) == ["bedroom", "kitchen", "R2"], graph)
    room = found.get_node(node_id("R0")).attributes
    assert found.get_labelspace(4, 0).labels_to_names[room.semantic_label] == "bedroom"
    assert sum(room.semantic_class_probabilities.values()) == pytest.approx(1)
    assert room.metadata.get()["roomtables"]["rule"] == "query"
    assert found.num_nodes() == graph.num_nodes()
    assert found.num_edges() == graph.num_edges()
    assert found.get_labelspace(2, 0).labels_to_names == LABELS
    assert wire.service.counters.rooms == {"from table": 2, "unanswered": 1}


def test_a_room_is_named_anew_when_its_objects_change(wire: Wire) -> None:
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))


def test_a_peer_that_vanishes_and_returns_is_heard_again(wire: Wire) -> None:
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    wire.sender._socket.close(linger=0)
    time.sleep(0.3)
    wire.sender = wire.new_sender()
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))


def test_hostile_messages_are_dropped_and_told_once(
    wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "roomtables")
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    good = live_graph(KITCHEN).to_binary()
    noise = random.Random(7)
    forged = b"\xdd\xff\xff\xff\xff" + good[5:]  # an array of four thousand million layers
    hostile = [b"", b"hello", noise.randbytes(500), good[:-9], good[:40], forged]
    for message in hostile * 2:
        wire.until_dropped(message)
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))
    told = [r.getMessage() for r in caplog.records if "dropped a message" in r.getMessage()]
    assert 1 <= len(told) == len({line.partition(": ")[2][:80] for line in told})


def test_a_graph_whose_labels_nothing_names_is_dropped_with_advice(
    wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    wire.until_dropped(live_graph(KITCHEN, named=False).to_binary())
    wire.until(lambda g: names(g) == ["office"], live_graph(OFFICE))
    assert "give one with `--labelspace FILE.yaml`" in caplog.text


def test_a_graph_without_rooms_passes_through(wire: Wire) -> None:
    empty = spark_dsg.DynamicSceneGraph()
    wire.until(lambda g: g.num_nodes() == 0, empty)


def test_counters_are_reported_also_when_nothing_comes(
    wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "roomtables")
    time.sleep(0.5)
    assert "0 graphs in, 0 out, 0 dropped; rooms now: none; median n/a" in caplog.text
    assert f"no graph from {wire.recv}" in caplog.text


def test_an_address_in_use_or_malformed_is_one_clear_error(wire: Wire, opened: RoomTables) -> None:
    for recv, send in ((wire.recv, wire.send), ("nonsense", free_url())):
        with pytest.raises(InputError, match="cannot use --"):
            Service(GraphCodec(), Labeller(opened), lambda *_: None, recv, send)


# -- what answers a room -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables that hold no query combination at all."""
    return build_tables(tmp_path_factory.mktemp("sparse"), combinations="none")


def test_what_no_table_holds_is_pooled_at_once_and_asked_of_the_model(sparse: Path) -> None:
    opened = RoomTables.open(sparse, "flat", offline=True)
    scorer = FitScorer()
    labeller = Labeller(opened, RoomTables.open(sparse, "flat", scorer=scorer))
    first = labeller.label({"R0": ("oven", "fridge")})["R0"]
    assert (first.room, first.rule) == ("kitchen", "pooled")
    deadline = time.monotonic() + 20
    while not labeller.take_model_answers() and time.monotonic() < deadline:
        time.sleep(0.01)
    second = labeller.label({"R0": ("fridge", "oven")})["R0"]
    assert (second.room, second.rule, second.answered_by) == ("kitchen", "query", "lm")
    assert scorer.calls == 1
    labeller.close()


def test_without_a_model_the_pooled_answer_stands(sparse: Path) -> None:
    labeller = Labeller(RoomTables.open(sparse, "flat", offline=True))
    answers = labeller.label({"R0": ("oven",), "R1": ()})
    assert answers["R0"].rule == "pooled"
    assert answers["R1"].room is None
    assert not labeller.take_model_answers()
    labeller.close()


def test_a_model_that_fails_is_told_once_and_asked_no_more(
    sparse: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Failing(FitScorer):
        def score(self, sentences: Any) -> Any:
            self.calls += 1
            raise ModelError("out of order")

    scorer = Failing()
    with_model = RoomTables.open(sparse, "flat", scorer=scorer)
    labeller = Labeller(RoomTables.open(sparse, "flat", offline=True), with_model)
    for objects in (["oven"], ["bed"], ["oven", "bed"]):
        assert labeller.label({"R0": objects})["R0"].rule == "pooled"
    deadline = time.monotonic() + 20
    while "out of order" not in caplog.text and time.monotonic() < deadline:
        time.sleep(0.01)
    labeller.close()
    assert caplog.text.count("no model from here on (out of order)") == 1
    assert scorer.calls == 1


def test_an_unchanged_room_is_not_decided_again(opened: RoomTables) -> None:
    class Counting:
        def __init__(self) -> None:
            self.asked = 0

        def classify(self, objects: list[str]) -> Any:
            self.asked += 1
            return opened.classify(objects)

        def deciding(self, **changes: Any) -> RoomTables:
            return opened.deciding(**changes)

    counting = Counting()
    labeller = Labeller(counting)  # type: ignore[arg-type]
    for _ in range(5):
        labeller.label({"R0": ("bed", "lamp"), "R1": ("lamp", "bed", "bed"), "R2": ("oven",)})
    assert counting.asked == 2
    labeller.label({"R0": ("bed", "lamp", "chair"), "R2": ("oven",)})
    assert counting.asked == 3


def test_the_models_answer_is_published_without_another_graph(sparse: Path) -> None:
    class Slow(FitScorer):
        def score(self, sentences: Any) -> Any:
            time.sleep(0.5)
            return super().score(sentences)

    opened = RoomTables.open(sparse, "flat", offline=True)
    wire = Wire(opened, RoomTables.open(sparse, "flat", scorer=Slow()))
    try:
        wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:  # nothing is sent any more
            if wire.receiver.recv(100):
                room = wire.receiver.graph.get_node(node_id("R0")).attributes
                if room.metadata.get()["roomtables"]["answered_by"] == "lm":
                    break
        else:
            raise AssertionError("the model's answer was never published")
    finally:
        wire.close()


def test_memory_does_not_grow_with_updates(opened: RoomTables) -> None:
    """Fifty rooms, each update another graph: neither caches nor buffers may keep them."""
    codec, labeller, namer = GraphCodec(), Labeller(opened), Namer(opened)
    choices = [BEDROOM, KITCHEN, OFFICE, (1, 3), (2, 4, 5)]
    messages = [
        live_graph(*[choices[(at + room) % 5] for room in range(50)]).to_binary() for at in range(5)
    ]

    def update(times: int) -> int:
        for at in range(times):
            scene = codec.decode(messages[at % 5])
            answers = labeller.label(scene.rooms)
            scene.name_rooms(namer(answers), ["bedroom", "kitchen", "office"])
            scene.encode()
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")

    if not Path("/proc/self/statm").exists():
        pytest.skip("resident memory is read from /proc")
    update(100)  # allocators and caches fill
    before = update(100)
    assert update(400) - before < 4 << 20  # 400 messages kept would be several times that


def test_a_forged_length_cannot_take_the_memory(tmp_path: Path) -> None:
    """Every array length of a message blown up in turn: refused, and the limit is lifted again."""
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)
    good = live_graph(BEDROOM).to_binary()
    codec = GraphCodec()
    refused = 0
    for at in range(len(good) - 5):
        if good[at] == 0xDD:
            try:
                codec.decode(good[: at + 1] + b"\xff\xff\xff\x7f" + good[at + 5 :])
            except InputError:
                refused += 1
    assert refused > 20
    assert resource.getrlimit(resource.RLIMIT_AS) == limit


def test_counters_name_the_median_in_milliseconds() -> None:
    counters = Counters(received=2)
    counters.latencies.extend([0.001, 0.003, 0.002])
    assert counters.line().endswith("median 2.0 ms")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_labels_and_stops_cleanly_on_a_signal(
    tables: Path, number: signal.Signals
) -> None:
    recv, send = free_url(), free_url()
    command = [sys.executable, "-m", "roomtables", "serve", "--recv", recv, "--send", send]
    command += ["--tables", str(tables), "--labels", "flat", "--offline", "--report-every", "0.2"]
    context = zmq.Context()
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        sender = spark_dsg_zmq.DsgSender(recv, context=context)
        receiver = spark_dsg_zmq.DsgReceiver(send, context=context)
        deadline = time.monotonic() + 30
        graph, labelled = live_graph(BEDROOM), False
        while not labelled and time.monotonic() < deadline:
            sender.send(graph)
            labelled = receiver.recv(100) and names(receiver.graph) == ["bedroom"]
        assert labelled
        process.send_signal(number)
        _, errors = process.communicate(timeout=15)
    finally:
        process.kill()
        context.destroy(linger=0)
    assert process.returncode == 0
    assert errors.splitlines()[-1].startswith("stopped: ")
    assert "1 from table" in errors
    assert "Traceback" not in errors
