"""`roomtables serve` on loopback, against a relay that only decodes and encodes each graph.

    python tests/benchmarks/bench_serve.py --updates 10000

Sends graphs of 50 rooms at 100 updates a second; every update changes one room. Prints, for both,
the time from sending a graph to receiving it labelled, and the memory that the process holds.
"""

from __future__ import annotations

import argparse
import os
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import spark_dsg
import zmq

sys.path.insert(0, str(Path(__file__).parents[1]))

from scene_builders import node_id
from tiny_tables import build_tables

LABELS = {1: "bed", 2: "lamp", 3: "oven", 4: "chair", 5: "fridge"}
CONTENTS = [(1, 2), (3, 5), (4,), (1, 3), (2, 4, 5)]
STAMP = re.compile(rb"update-(\d{8})-")
ROOMS, OBJECTS = 50, 8
RELAY = """
import sys, zmq, spark_dsg
context = zmq.Context()
incoming, outgoing = context.socket(zmq.SUB), context.socket(zmq.PUB)
incoming.setsockopt(zmq.SUBSCRIBE, b""); incoming.setsockopt(zmq.CONFLATE, 1)
incoming.connect(sys.argv[1]); outgoing.bind(sys.argv[2])
while True:
    outgoing.send(spark_dsg.DynamicSceneGraph.from_binary(incoming.recv()).to_binary())
"""


def graph_message(update: int) -> bytes:
    """A graph whose room ``update % 50`` differs from the graph before."""
    graph = spark_dsg.DynamicSceneGraph()
    spaces = {"_l2p0": [[key, name] for key, name in LABELS.items()]}
    graph.metadata.set({"labelspaces": spaces, "stamp": "update-00000000-"})
    for room in range(ROOMS):
        symbol = node_id(f"R{room}")
        graph.add_node("ROOMS", symbol, spark_dsg.RoomNodeAttributes())
        graph.add_node("PLACES", node_id(f"p{room}"), spark_dsg.PlaceNodeAttributes())
        graph.insert_edge(symbol, node_id(f"p{room}"))
        contents = CONTENTS[(room + (update % ROOMS >= room)) % len(CONTENTS)]
        for number in range(OBJECTS):
            thing = spark_dsg.ObjectNodeAttributes()
            thing.semantic_label = contents[number % len(contents)]
            key = node_id(f"O{100 * room + number}")
            graph.add_node("OBJECTS", key, thing)
            graph.insert_edge(node_id(f"p{room}"), key)
    message: bytes = graph.to_binary()
    return message


def free_url() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


def resident_bytes(pid: int) -> int:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def drive(
    command: list[str], recv: str, send: str, messages: list[bytes], args: argparse.Namespace
) -> tuple[list[float], int, int]:
    """Round trips in seconds, and resident bytes after a tenth of the updates and after all."""
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    context = zmq.Context()
    out, back = context.socket(zmq.PUB), context.socket(zmq.SUB)
    out.bind(recv)
    back.setsockopt(zmq.SUBSCRIBE, b"")
    back.connect(send)
    sent: dict[int, float] = {}
    trips: list[float] = []
    over = threading.Event()

    def receive() -> None:
        while not over.is_set():
            if back.poll(100):
                message, now = back.recv(), time.perf_counter()
                stamp = STAMP.search(message)
                if stamp and (started := sent.pop(int(stamp[1]), None)) is not None:
                    trips.append(now - started)

    thread = threading.Thread(target=receive)
    thread.start()
    early = 0
    try:
        while not trips:  # the processes find each other
            sent[0] = time.perf_counter()
            out.send(messages[0])
            time.sleep(0.2)
        trips.clear()
        due = time.perf_counter()
        for update in range(1, args.updates + 1):
            due += 1 / args.rate
            time.sleep(max(0.0, due - time.perf_counter()))
            message = messages[update % len(messages)]
            message = message.replace(b"update-00000000-", b"update-%08d-" % update, 1)
            sent[update] = time.perf_counter()
            out.send(message)
            if update == args.updates // 10:
                early = resident_bytes(process.pid)
        time.sleep(0.5)
        late = resident_bytes(process.pid)
    finally:
        over.set()
        thread.join()
        process.terminate()
        process.wait()
        context.destroy(linger=0)
    return trips, early, late


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=100.0, help="updates a second")
    args = parser.parse_args()
    messages = [graph_message(update) for update in range(ROOMS)]
    print(
        f"{args.updates} updates at {args.rate:g}/s, {ROOMS} rooms, {ROOMS * OBJECTS} objects, "
        f"{len(messages[0])} bytes"
    )
    with tempfile.TemporaryDirectory() as folder:
        tables = build_tables(Path(folder))
        medians = {}
        for name in ("relay", "serve"):
            recv, send = free_url(), free_url()
            command = [sys.executable, "-c", RELAY, recv, send]
            if name == "serve":
                command = [sys.executable, "-m", "roomtables", "serve", "--offline", "--recv", recv]
                command += ["--send", send, "--tables", str(tables), "--labels", "flat"]
            trips, early, late = drive(command, recv, send, messages, args)
            medians[name] = statistics.median(trips)
            tail = statistics.quantiles(trips, n=100)[98]
            print(
                f"{name}: {len(trips)} back, median {1e3 * medians[name]:.1f} ms, "
                f"99th percentile {1e3 * tail:.1f} ms, memory {early / 2**20:.1f} MB after a "
                f"tenth, {late / 2**20:.1f} MB after all"
            )
    print(f"serve / relay: {medians['serve'] / medians['relay']:.2f}")


if __name__ == "__main__":
    main()
