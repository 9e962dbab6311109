"""Label a running robot's rooms: graphs in over ZMQ, the same graphs with named rooms out.

Needs ``pyzmq``, of the extra ``scene-graphs``.
"""

from __future__ import annotations

import importlib
import logging
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from roomtables.errors import InputError, needing
from roomtables.online.live import GraphLabeller

log = logging.getLogger(__name__)

_POLL_MS = 100
_LARGEST_MESSAGE = 256 << 20  # bytes
# Graphs that arrive while one is labelled are labelled in their order, unless there are more, or
# they wait longer: of those the newest alone is labelled.
_MOST_WAITING = 48
_LONGEST_WAIT = 0.5  # seconds
_QUEUE = 48  # graphs in the queue of a socket
_ALL_INTERFACES = re.compile(r"tcp://(0\.0\.0\.0|\*|\[::\]|::)(:|$)")


class Service:
    """The loop between two sockets.

    Parameters
    ----------
    graphs : what labels messages
    receive, send
        ZMQ addresses: subscribes to the first (connects), publishes on the second (binds).

    Raises
    ------
    InputError
        An address is malformed, or taken by another process.
    MissingExtraError
        ``pyzmq`` is not installed.
    """

    def __init__(self, graphs: GraphLabeller, receive: str, send: str) -> None:
        self._graphs = graphs
        self._receive_url = receive
        zmq = _zmq()
        self._context = zmq.Context()
        try:
            self._in = self._socket(zmq.SUB, zmq.RCVHWM, _QUEUE)
            self._in.setsockopt(zmq.SUBSCRIBE, b"")
            self._out = self._socket(zmq.PUB, zmq.SNDHWM, _QUEUE)
            self._open("--recv", receive, self._in.connect)
            self._open("--send", send, self._out.bind)
        except InputError:
            self.close()
            raise
        if _ALL_INTERFACES.match(send):
            log.warning(
                "--send %s publishes to every machine that reaches this one, neither encrypted nor "
                "authenticated; use tcp://127.0.0.1:8002 unless that is meant", send,
            )  # fmt: skip

    def _socket(self, kind: int, option: int, value: int) -> Any:
        zmq = _zmq()
        socket = self._context.socket(kind)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST_MESSAGE)
        socket.setsockopt(option, value)
        return socket

    @staticmethod
    def _open(option: str, url: str, open_: Callable[[str], Any]) -> None:
        try:
            open_(url)
        except _zmq().ZMQError as error:
            raise InputError(
                f"cannot use {option} {url} ({error.strerror}); give an address such as "
                "tcp://127.0.0.1:8002 that no other process holds"
            ) from error

    def close(self) -> None:
        """Close both sockets, dropping what is not sent."""
        self._graphs.close()
        self._context.destroy(linger=0)

    def run(self, stop: threading.Event, report_every: float = 10.0) -> None:
        """Label graphs until ``stop`` is set; every ``report_every`` seconds log the counters."""
        counters = self._graphs.counters
        due, before = time.monotonic() + report_every, 0
        while not stop.is_set():
            if self._in.poll(_POLL_MS):
                self._label_waiting()
            self._publish(self._graphs.take_model_answers())
            if time.monotonic() >= due:
                self._report(idle=counters.received == before)
                due, before = time.monotonic() + report_every, counters.received

    def _label_waiting(self) -> None:
        """Label the graphs that have arrived, in order; where that takes too long, the newest."""
        messages = deque([self._in.recv()])
        while len(messages) <= _QUEUE and self._in.poll(0):
            messages.append(self._in.recv())
        late = time.monotonic() + _LONGEST_WAIT
        while messages:
            if len(messages) > _MOST_WAITING or time.monotonic() > late:
                messages = deque([messages[-1]])
            self._publish(self._graphs.take(messages.popleft()))

    def _publish(self, message: bytes | None) -> None:
        if message is not None:
            self._out.send(message)

    def _report(self, idle: bool) -> None:
        waiting = f"; no graph from {self._receive_url} since the last line" if idle else ""
        log.info("%s%s", self._graphs.report(), waiting)


def _zmq() -> Any:
    with needing("serving scene graphs"):
        return importlib.import_module("zmq")
