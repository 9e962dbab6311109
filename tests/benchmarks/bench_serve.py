"""`roomtables serve` on loopback, against a relay that only decodes and encodes each graph.

    python tests/benchmarks/bench_serve.py
    python tests/benchmarks/bench_serve.py --seconds 600 --questions 2000

Sends graphs of 50 rooms with 5 objects each at 100 updates a second; every update changes one room.
A share of the objects has names that no table knows, so that rooms are asked of the language model
while graphs go by. Prints how many graphs came back and how soon, how many of the names in them
were right (those of the tables, the back-off or the model), whether every question was answered in
the end as `classify` answers it, and the memory that the process holds.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import spark_dsg
import zmq

sys.path.insert(0, str(Path(__file__).parents[1]))

from roomtables import RoomTables, build
from scene_builders import node_id

HYDRAS_NAME = re.compile(r"R\d+")  # of a room that nothing is known of as yet
STAMP = re.compile(rb"update-(\d{8})-")
OBJECTS = 5  # in a room
SAMPLE = 25  # of this many graphs that come back, the names in one are looked at
UNKNOWN = [
    f"{of} {thing}"
    for of in ("steel", "pocket", "garden", "folding", "travel", "toy")
    for thing in ("kettle", "laptop", "guitar", "wok", "stapler", "blackboard", "drill")
]
RELAY = """
import sys, zmq, spark_dsg
context = zmq.Context()
incoming, outgoing = context.socket(zmq.SUB), context.socket(zmq.PUB)
incoming.setsockopt(zmq.SUBSCRIBE, b""); incoming.setsockopt(zmq.CONFLATE, 1)
incoming.connect(sys.argv[1]); outgoing.bind(sys.argv[2])
while True:
    outgoing.send(spark_dsg.DynamicSceneGraph.from_binary(incoming.recv()).to_binary())
"""
Contents = tuple[str, ...]  # the names of a room's objects


def made_rooms(known: Sequence[str], share: float, count: int) -> list[Contents]:
    """Distinct rooms; a share of their objects has names that no table knows."""
    chance, rooms = random.Random(11), dict[Contents, None]()
    while len(rooms) < count:
        unknown = sum(chance.random() < share for _ in range(OBJECTS))
        names = chance.sample(known, OBJECTS - unknown) + chance.sample(UNKNOWN, unknown)
        rooms[tuple(sorted(names))] = None
    return list(rooms)


def made_messages(pool: Sequence[Contents], rooms: int, names: Sequence[str]) -> list[bytes]:
    """As many graphs as contents: each has one room changed to the next of the pool."""
    graph, numbers = spark_dsg.DynamicSceneGraph(), {name: at for at, name in enumerate(names)}
    spaces = {"_l2p0": [[at, name] for at, name in enumerate(names)]}
    graph.metadata.set({"labelspaces": spaces, "stamp": "update-00000000-"})
    for room in range(rooms):
        attributes = spark_dsg.RoomNodeAttributes()
        attributes.name = f"R{room}"
        graph.add_node("ROOMS", node_id(f"R{room}"), attributes)
        graph.add_node("PLACES", node_id(f"p{room}"), spark_dsg.PlaceNodeAttributes())
        graph.insert_edge(node_id(f"R{room}"), node_id(f"p{room}"))
        for at in range(OBJECTS):
            key = node_id(f"O{100 * room + at}")
            graph.add_node("OBJECTS", key, spark_dsg.ObjectNodeAttributes())
            graph.insert_edge(node_id(f"p{room}"), key)
    messages = []
    for update in range(-rooms, len(pool)):
        room = update % rooms
        for at, name in enumerate(pool[update % len(pool)]):
            thing = graph.get_node(node_id(f"O{100 * room + at}")).attributes
            thing.semantic_label = numbers[name]
        if update >= 0:
            messages.append(graph.to_binary())
    return messages


def rooms_in(message: bytes) -> dict[Contents, str | None]:
    """The objects' names of each room in a graph, and the name that it bears, if it has one."""
    graph = spark_dsg.DynamicSceneGraph.from_binary(message)
    names = graph.get_labelspace(2, 0).labels_to_names
    found = {}
    for node in graph.get_layer("ROOMS").nodes:
        [place] = node.children()
        objects = [graph.get_node(key).attributes for key in graph.get_node(place).children()]
        name = None if HYDRAS_NAME.fullmatch(node.attributes.name) else node.attributes.name
        found[tuple(sorted(names[thing.semantic_label] for thing in objects))] = name
    return found


def free_url() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


def resident_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


class Peer:
    """Sends graphs to a process, and keeps what comes back."""

    def __init__(self, command: list[str], recv: str, send: str) -> None:
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.context = zmq.Context()
        self.out, self.back = self.context.socket(zmq.PUB), self.context.socket(zmq.SUB)
        self.out.bind(recv)
        self.back.setsockopt(zmq.SUBSCRIBE, b"")
        self.back.connect(send)
        self.sent: dict[int, float] = {}
        self.trips: list[float] = []
        self.sampled: list[bytes] = []
        self.last, self.told, self.over = b"", "", threading.Event()
        self.threads = [threading.Thread(target=work) for work in (self._receive, self._read)]
        for thread in self.threads:
            thread.start()

    def _receive(self) -> None:
        while not self.over.is_set():
            if self.back.poll(100):
                message, now = self.back.recv(), time.perf_counter()
                stamp = STAMP.search(message)
                if stamp and (started := self.sent.pop(int(stamp[1]), None)) is not None:
                    self.trips.append(now - started)
                    if len(self.trips) % SAMPLE == 0:
                        self.sampled.append(message)
                self.last = message

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.told = line.strip() if "graphs in" in line else self.told
            if "warning" in line:
                print(line, end="", file=sys.stderr)

    def send(self, update: int, message: bytes) -> None:
        message = message.replace(b"update-00000000-", b"update-%08d-" % update, 1)
        self.sent[update] = time.perf_counter()
        self.out.send(message)

    def meet(self, message: bytes) -> None:
        """Wait until the processes have found each other."""
        while not self.trips:
            self.send(0, message)
            time.sleep(0.2)
        self.trips.clear()

    def stream(self, messages: list[bytes], rate: float, seconds: float) -> tuple[int, float]:
        """Send graphs; how many, and the memory after the first minute, or a tenth if shorter."""
        begun = due = time.perf_counter()
        early, update, memory = min(60.0, seconds / 10), 0, 0.0
        while due - begun < seconds:
            update, due = update + 1, due + 1 / rate
            time.sleep(max(0.0, due - time.perf_counter()))
            self.send(update, messages[update % len(messages)])
            if not memory and due - begun >= early:
                memory = resident_mb(self.process.pid)
        time.sleep(0.5)
        return update, memory

    def close(self) -> None:
        self.over.set()
        self.process.terminate()
        self.process.wait()
        for thread in self.threads:
            thread.join()
        self.context.destroy(linger=0)


def report(name: str, peer: Peer, sent: int, early: float, late: float) -> float:
    """Print a line; the median of the round trips, in seconds."""
    median, tail = statistics.median(peer.trips), statistics.quantiles(peer.trips, n=100)[98]
    print(
        f"{name}: {sent} graphs sent, {len(peer.trips)} back, median {1e3 * median:.1f} ms, "
        f"99th percentile {1e3 * tail:.1f} ms, memory {early:.1f} MB early, {late:.1f} MB late"
    )
    return median


def judge(peer: Peer, pool: list[Contents], messages: list[bytes], tables: Any, model: Any) -> None:
    """Print how many names were right while graphs went by, and how many are in the end."""
    at_once = dict(zip(pool, tables.classify_many(pool).rooms, strict=True))
    asked = dict(zip(pool, model.classify_many(pool).rooms, strict=True)) if model else at_once
    right = total = 0
    for message in peer.sampled:
        for contents, name in rooms_in(message).items():
            total += 1
            right += name in (at_once[contents], asked[contents])
            if name not in (at_once[contents], asked[contents]):
                print(f"wrong: {name} for {', '.join(contents)}")
    print(f"names right while graphs went by: {right} of {total} looked at")
    in_the_end: dict[Contents, str | None] = {}
    for once_more in range(2):  # what the first round asks about is answered in the second
        waited = time.perf_counter()
        while "waiting" in peer.told and time.perf_counter() - waited < 600:
            time.sleep(0.5)
        for update, message in enumerate(messages):
            peer.send((1 + once_more) * 10_000_000 + update, message)
            time.sleep(0.02)
            in_the_end |= rooms_in(peer.last)
        time.sleep(2)  # a line of counters
    answered = sum(in_the_end.get(contents) == asked[contents] for contents in pool)
    print(f"answered in the end as classify answers: {answered} of {len(pool)}; {peer.told}")


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=100.0, help="updates a second")
    parser.add_argument("--rooms", type=int, default=50, help="in a graph")
    parser.add_argument("--unknown", type=float, default=0.2, help="share of unknown names")
    parser.add_argument("--questions", type=int, default=200, help="distinct rooms, at most")
    parser.add_argument("--offline", action="store_true", help="no language model")
    parser.add_argument("--tables", help="tables of label space mpcat40; else they are built")
    return parser.parse_args()


def main() -> None:
    args = options()
    with tempfile.TemporaryDirectory() as folder:
        tables = args.tables or f"{folder}/tables"
        if not args.tables:
            build(tables=tables, labels="mpcat40", combinations="none")
        opened = RoomTables.open(tables, "mpcat40", offline=True, note_misses=False)
        model = None if args.offline else RoomTables.open(tables, "mpcat40", note_misses=False)
        known = [entry.label for entry in opened.lookup.objects]
        pool = made_rooms(known, args.unknown, args.questions)
        messages = made_messages(pool, args.rooms, [*known, *UNKNOWN])
        print(
            f"{args.seconds:g} s at {args.rate:g}/s, {args.rooms} rooms of {OBJECTS} objects, "
            f"{args.unknown:.0%} of their names unknown, {len(pool)} distinct rooms, "
            f"{len(messages[0])} bytes"
        )
        recv, send = free_url(), free_url()
        peer = Peer([sys.executable, "-c", RELAY, recv, send], recv, send)
        peer.meet(messages[0])
        sent, early = peer.stream(messages, args.rate, min(args.seconds, 10.0))
        relay = report("relay", peer, sent, early, resident_mb(peer.process.pid))
        peer.close()
        recv, send = free_url(), free_url()
        command = [sys.executable, "-m", "roomtables", "serve", "--recv", recv, "--send", send]
        command += ["--tables", tables, "--labels", "mpcat40", "--report-every", "1"]
        command += ["--margin", "0", "--hold", "1", *(["--offline"] if args.offline else [])]
        peer = Peer(command, recv, send)
        try:
            peer.meet(messages[0])
            sent, early = peer.stream(messages, args.rate, args.seconds)
            late = resident_mb(peer.process.pid)
            print(f"serve / relay: {report('serve', peer, sent, early, late) / relay:.2f}")
            judge(peer, pool, messages, opened, model)
        finally:
            peer.close()


if __name__ == "__main__":
    main()
