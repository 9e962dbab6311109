"""Label a running robot's rooms: graphs in over ZMQ, the same graphs with named rooms out.

What a graph looks like on the wire is a :class:`Codec`'s business. A room whose objects have not
changed costs one dictionary lookup. Needs ``pyzmq``, of the extra ``scene-graphs``.
"""

from __future__ import annotations

import importlib
import logging
import statistics
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, Full, Queue
from typing import Any, Protocol

from roomtables.errors import InputError, RoomtablesError, needing
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import LM, NONE, Prediction
from roomtables.schemas import POOLED

log = logging.getLogger(__name__)

_POLL_MS = 100
_LARGEST_MESSAGE = 256 << 20  # bytes
_MOST_ANSWERS = 65_536  # remembered, by a room's objects
_MOST_PENDING = 256  # rooms that wait for the language model
_LATENCIES = 1_000  # of which the median is shown


class LiveScene(Protocol):
    """A decoded message."""

    @property
    def rooms(self) -> Mapping[str, tuple[str, ...]]:
        """Each room's id, and the labels of the objects in it."""
        ...

    def encode(self) -> bytes:
        """The message to publish."""
        ...


class Codec(Protocol):
    """Decodes messages."""

    def decode(self, message: bytes) -> LiveScene:
        """The scene in a message; `InputError` where it holds none."""
        ...


# Writes answers into a decoded scene, by room id.
NameRooms = Callable[[Any, Mapping[str, Prediction]], None]


class Labeller:
    """Answers rooms at once, from the tables; the language model's answers come later.

    Answers are remembered by a room's objects.

    Parameters
    ----------
    tables
        Opened offline: answers what the tables hold; rule ``pooled`` answers the rest.
    with_model
        The same tables with the language model allowed, or ``None``. A thread of its own asks it
        for what the tables do not hold.
    """

    def __init__(self, tables: RoomTables, with_model: RoomTables | None = None) -> None:
        self._tables = tables
        self._pooled = tables.deciding(rule=POOLED)
        self._with_model = with_model
        self._answers: OrderedDict[frozenset[str], Prediction] = OrderedDict()
        self._pending: Queue[frozenset[str] | None] = Queue(_MOST_PENDING)
        self._model_answers: Queue[tuple[frozenset[str], Prediction]] = Queue()
        self._thread: threading.Thread | None = None

    def label(self, rooms: Mapping[str, Iterable[str]]) -> dict[str, Prediction]:
        """The answer for each room, by id."""
        return {key: self._answer(frozenset(objects)) for key, objects in rooms.items()}

    def take_model_answers(self) -> bool:
        """Take over what the language model has answered since; whether there was anything."""
        taken = False
        while True:
            try:
                objects, answer = self._model_answers.get_nowait()
            except Empty:
                return taken
            self._remember(objects, answer)
            taken = True

    def close(self) -> None:
        """Let the model's thread end with the room it is at."""
        if self._thread is not None and self._thread.is_alive():
            with suppress(Empty):
                while True:
                    self._pending.get_nowait()
            self._pending.put(None)

    def _answer(self, objects: frozenset[str]) -> Prediction:
        answer = self._answers.get(objects)
        if answer is None:
            answer = self._tables.classify(sorted(objects))
            if (answer.answered_by == NONE or answer.backed_off) and objects:
                self._ask_later(objects)
                answer = self._pooled.classify(sorted(objects))
            self._remember(objects, answer)
        return answer

    def _remember(self, objects: frozenset[str], answer: Prediction) -> None:
        self._answers[objects] = answer
        if len(self._answers) > _MOST_ANSWERS:
            self._answers.popitem(last=False)

    def _ask_later(self, objects: frozenset[str]) -> None:
        if self._with_model is None:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._ask_model, name="model", daemon=True)
            self._thread.start()
        try:
            self._pending.put_nowait(objects)
        except Full:
            log.warning("the model is %d questions behind; one is dropped", _MOST_PENDING)

    def _ask_model(self) -> None:
        """The thread's work: ask about one room after the other, until close or a failure."""
        while self._with_model is not None and (objects := self._pending.get()) is not None:
            try:
                answer = self._with_model.classify(sorted(objects))
            except (RoomtablesError, MemoryError) as error:
                log.warning("no model from here on (%s); rule pooled stands", error)
                self._with_model = None
                return
            if answer.answered_by == LM:
                self._model_answers.put((objects, answer))


@dataclass
class Counters:
    """What a service has done.

    Attributes
    ----------
    received, published, dropped : how many graphs
    rooms : of the last graph, by how they were answered
    latencies : seconds from a graph's receipt to its publication, the last thousand
    """

    received: int = 0
    published: int = 0
    dropped: int = 0
    rooms: Counter[str] = field(default_factory=Counter)
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=_LATENCIES))

    def line(self) -> str:
        """The counters in a line; the median is of the last thousand graphs."""
        rooms = ", ".join(f"{count} {how}" for how, count in sorted(self.rooms.items())) or "none"
        taken = f"{1e3 * statistics.median(self.latencies):.1f} ms" if self.latencies else "n/a"
        return (
            f"{self.received} graphs in, {self.published} out, {self.dropped} dropped; "
            f"rooms now: {rooms}; median {taken}"
        )


class Service:
    """The loop between two sockets.

    Parameters
    ----------
    codec, labeller, name_rooms
        What reads graphs, what answers their rooms, and what writes the answers in.
    receive, send
        ZMQ addresses: subscribes to the first (connects), publishes on the second (binds).

    Raises
    ------
    InputError
        An address is malformed, or taken by another process.
    MissingExtraError
        ``pyzmq`` is not installed.
    """

    def __init__(
        self, codec: Codec, labeller: Labeller, name_rooms: NameRooms, receive: str, send: str
    ) -> None:
        self._codec, self._labeller, self._name_rooms = codec, labeller, name_rooms
        self._receive_url = receive
        self.counters = Counters()
        self._received: bytes | None = None  # the message that the scene was decoded from
        self._scene: LiveScene | None = None
        self._labelled = b""
        self._complaints: Counter[str] = Counter()
        zmq = _zmq()
        self._context = zmq.Context()
        try:
            self._in = self._socket(zmq.SUB, zmq.CONFLATE, 1)
            self._in.setsockopt(zmq.SUBSCRIBE, b"")
            self._out = self._socket(zmq.PUB, zmq.SNDHWM, 4)
            self._open("--recv", receive, self._in.connect)
            self._open("--send", send, self._out.bind)
        except InputError:
            self.close()
            raise

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
        self._labeller.close()
        self._context.destroy(linger=0)

    def run(self, stop: threading.Event, report_every: float = 10.0) -> None:
        """Label graphs until ``stop`` is set; every ``report_every`` seconds log the counters."""
        due, before = time.monotonic() + report_every, 0
        while not stop.is_set():
            if self._in.poll(_POLL_MS):
                self._take(self._in.recv())
            if self._labeller.take_model_answers() and self._scene is not None:
                self._label(self._scene)
                self._send()
            if time.monotonic() >= due:
                self._report(idle=self.counters.received == before)
                due, before = time.monotonic() + report_every, self.counters.received

    def _report(self, idle: bool) -> None:
        waiting = f"; no graph from {self._receive_url} since the last line" if idle else ""
        log.info("%s%s", self.counters.line(), waiting)

    def _take(self, message: bytes) -> None:
        started = time.perf_counter()
        self.counters.received += 1
        if message != self._received or self._scene is None:
            try:
                scene = self._codec.decode(message)
                self._label(scene)
            except (InputError, MemoryError) as error:
                self._drop(message, str(error) or "out of memory")
                return
            self._received, self._scene = message, scene
        self._send()
        self.counters.latencies.append(time.perf_counter() - started)

    def _drop(self, message: bytes, reason: str) -> None:
        self.counters.dropped += 1
        kind = reason[:80]
        self._complaints[kind] += 1
        if self._complaints[kind] == 1 and len(self._complaints) <= 100:
            log.warning("dropped a message of %d bytes: %s", len(message), reason)

    def _label(self, scene: LiveScene) -> None:
        answers = self._labeller.label(scene.rooms)
        named = {key: answer for key, answer in answers.items() if answer.room is not None}
        self._name_rooms(scene, named)
        self.counters.rooms = Counter(map(_how, answers.values()))
        self._labelled = scene.encode()

    def _send(self) -> None:
        self._out.send(self._labelled)
        self.counters.published += 1


def _zmq() -> Any:
    with needing("serving scene graphs"):
        return importlib.import_module("zmq")


def _how(answer: Prediction) -> str:
    """How a room was answered, for the counters."""
    if answer.room is None:
        return "unanswered"
    if answer.answered_by == LM:
        return "by model"
    return "by pooled evidence" if answer.rule == POOLED else "from table"
