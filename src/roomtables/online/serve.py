"""Label a running robot's rooms: graphs in over ZMQ, the same graphs with named rooms out.

Needs ``pyzmq``, of the extra ``scene-graphs``.
"""

from __future__ import annotations

import importlib
import logging
import re
import threading
import time
from collections.abc import Callable
from typing import Any

from roomtables.errors import InputError, needing
from roomtables.online.live import GraphLabeller

log = logging.getLogger(__name__)

_POLL_MS = 100
_LARGEST_MESSAGE = 256 << 20  # bytes
_MOST_BEHIND = 20  # graphs that may wait while one is labelled; of more, the newest alone is taken
_MOST_BEHIND_BYTES = 64 << 20
_MOST_DRAINED = 1_000  # so that no flood keeps it from labelling
_QUEUE = 8  # graphs in the queue of a socket
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
            self._out = self._socket(zmq.PUB, zmq.SNDHWM, _MOST_BEHIND)
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
                for message in self._waiting():
                    self._publish(self._graphs.take(message))
            self._publish(self._graphs.take_model_answers())
            if time.monotonic() >= due:
                self._report(idle=counters.received == before)
                due, before = time.monotonic() + report_every, counters.received

    def _waiting(self) -> list[bytes]:
        """The graphs that have arrived, in order; of too many, the newest alone."""
        messages: list[bytes] = []
        behind = False
        for taken in range(_MOST_DRAINED):
            # What is taken out of a full queue, it has again a moment later.
            if not self._in.poll(1 if taken >= _QUEUE else 0):
                break
            messages.append(self._in.recv())
            if len(messages) > _MOST_BEHIND or sum(map(len, messages)) > _MOST_BEHIND_BYTES:
                behind = True
                del messages[:-1]
        return messages[-1:] if behind else messages

    def _publish(self, message: bytes | None) -> None:
        if message is not None:
            self._out.send(message)

    def _report(self, idle: bool) -> None:
        waiting = f"; no graph from {self._receive_url} since the last line" if idle else ""
        log.info("%s%s", self._graphs.report(), waiting)


def _zmq() -> Any:
    with needing("serving scene graphs"):
        return importlib.import_module("zmq")
