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

from roomtables.errors import InputError
from roomtables.online import serve
from roomtables.online.classifier import RoomTables
from roomtables.online.live import Counters
from roomtables.online.model_thread import ModelThread
from roomtables.online.serve import Service
from roomtables.online.steady_names import SteadyNames
from scene_builders import node_id
from tiny_tables import FitScorer, build_tables

spark_dsg = pytest.importorskip("spark_dsg")
spark_dsg_zmq = pytest.importorskip("spark_dsg.zmq")
zmq = pytest.importorskip("zmq")

from live_graphs import BEDROOM, KITCHEN, LABELS, OFFICE, graph_labeller, live_graph, names  # noqa: E402
from roomtables.scenes.live import GraphCodec  # noqa: E402


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

        self.graphs = graph_labeller(opened, ModelThread(with_model) if with_model else None)
        self.service = Service(self.graphs, self.recv, self.send)
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
        raise AssertionError(f"never published; {self.graphs.counters.line()}")

    def until_dropped(self, message: bytes) -> None:
        """Send a message again and again until the service has dropped it."""
        before, deadline = self.graphs.counters.dropped, time.monotonic() + 20
        while self.graphs.counters.dropped == before and time.monotonic() < deadline:
            self.sender._socket.send(message)
            time.sleep(0.02)
        assert self.graphs.counters.dropped > before

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
    assert wire.graphs.counters.rooms == {"from table": 2, "unanswered": 1}


def test_a_room_is_named_anew_when_its_objects_change(wire: Wire) -> None:
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))


def published_of_a_burst(wire: Wire, count: int) -> list[list[str]]:
    """The rooms' names in what comes back of graphs that are sent without a pause."""
    wire.until(lambda g: names(g) == ["office"], live_graph(OFFICE))
    while wire.receiver.recv(300):
        pass
    messages = [live_graph(*[BEDROOM] * (at + 1)).to_binary() for at in range(count)]
    for message in messages:
        wire.sender._socket.send(message)
    back = []
    while wire.receiver.recv(1500):
        back.append(names(wire.receiver.graph))
    return back


def test_graphs_that_arrive_close_together_are_all_labelled(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A machine under load labels slowly; how long a graph may wait is not what is tested here.
    monkeypatch.setattr(serve, "_LONGEST_WAIT", 60.0)
    assert published_of_a_burst(wire, 12) == [["bedroom"] * (at + 1) for at in range(12)]


def test_of_a_flood_the_newest_is_labelled(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    take = wire.graphs.take

    def slowly(message: bytes) -> bytes | None:
        time.sleep(0.1)
        return take(message)

    monkeypatch.setattr(wire.graphs, "take", slowly)
    back = published_of_a_burst(wire, 60)
    assert back[-1] == ["bedroom"] * 60
    assert len(back) < 50


def test_a_peer_that_vanishes_and_returns_is_heard_again(wire: Wire) -> None:
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    wire.sender._socket.close(linger=0)
    time.sleep(0.3)
    wire.sender = wire.new_sender()
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))


def test_hostile_messages_are_dropped_and_told_once_a_second(
    wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "roomtables")
    wire.until(lambda g: names(g) == ["bedroom"], live_graph(BEDROOM))
    good = live_graph(KITCHEN).to_binary()
    noise = random.Random(7)
    forged = b"\xdd\xff\xff\xff\xff" + good[5:]  # an array of four thousand million layers
    started = time.monotonic()
    hostile = [b"", b"hello", noise.randbytes(500), good[:-9], good[:40], forged]
    for message in hostile * 2:
        wire.until_dropped(message)
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))
    told = caplog.text.count("dropped a message")
    assert 1 <= told <= 1 + time.monotonic() - started  # all are of one kind: one line a second


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
            Service(graph_labeller(opened), recv, send)


# -- what answers a room -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables that hold no query combination at all."""
    return build_tables(tmp_path_factory.mktemp("sparse"), combinations="none")


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
    graphs = graph_labeller(opened, names=SteadyNames())
    choices = [BEDROOM, KITCHEN, OFFICE, (1, 3), (2, 4, 5)]
    messages = [
        live_graph(*[choices[(at + room) % 5] for room in range(50)]).to_binary() for at in range(5)
    ]

    def update(times: int) -> int:
        for at in range(times):
            assert graphs.take(messages[at % 5]) is not None
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")

    if not Path("/proc/self/statm").exists():
        pytest.skip("resident memory is read from /proc")
    update(50)  # allocators and caches fill
    before = update(50)
    kept = 150 * sum(map(len, messages)) // 5  # were all kept
    assert update(150) - before < kept // 3


def test_a_malformed_graph_does_not_end_the_service(wire: Wire) -> None:
    """Fault A1, over real sockets."""
    graph = live_graph(KITCHEN)
    graph.metadata.set(dict(graph.metadata.get()) | {"labelspaces": "none"})
    wire.until_dropped(graph.to_binary())
    wire.until(lambda g: names(g) == ["kitchen"], live_graph(KITCHEN))


@pytest.mark.parametrize(
    ("host", "warned"), [("0.0.0.0", True), ("*", True), ("127.0.0.1", False), ("localhost", False)]
)
def test_publishing_on_all_interfaces_is_warned_of(
    opened: RoomTables, host: str, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """Fault B11."""
    send = free_url().replace("127.0.0.1", host)
    Service(graph_labeller(opened), free_url(), send).close()
    assert ("every machine that reaches this one" in caplog.text) == warned


def test_the_report_says_what_waits_and_what_is_not_known(sparse: Path) -> None:
    gate = threading.Event()

    class Gated(FitScorer):
        def score(self, sentences: Any) -> Any:
            gate.wait(30)
            return super().score(sentences)

    tables = RoomTables.open(sparse, "flat", offline=True)
    graphs = graph_labeller(tables, ModelThread(RoomTables.open(sparse, "flat", scorer=Gated())))
    graph = live_graph(KITCHEN, BEDROOM, (), labels={**LABELS, 2: "chiar"})
    assert graphs.take(graph.to_binary()) is not None
    line = graphs.report()
    assert "rooms now: 2 by back-off, 1 unanswered" in line
    assert "2 questions waiting; 1 unknown name: chiar 1" in line
    gate.set()
    graphs.take_model_answers()
    graphs.close()


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
