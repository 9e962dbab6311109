"""Graphs of a running robot: one message in, the same graph with named rooms out, or nothing.

What a graph looks like on the wire is a :class:`Codec`'s business. Nothing that a message holds
can end the service: whatever goes wrong with one, that one is dropped, counted and told of.
"""

from __future__ import annotations

import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from roomtables.errors import InputError, first_line
from roomtables.online.complaints import Complaints
from roomtables.online.labeller import Labeller
from roomtables.online.prediction import LM, Prediction
from roomtables.online.steady_names import NamedScene, SteadyName, SteadyNames

_LATENCIES = 1_000  # of which the median is shown


class LiveScene(NamedScene, Protocol):
    """A decoded message."""

    def encode(self) -> bytes:
        """The message to publish."""
        ...


class Codec(Protocol):
    """Decodes messages."""

    def decode(self, message: bytes) -> LiveScene:
        """The scene in a message; `InputError` where it holds none."""
        ...


# Writes names into a decoded scene, by room id.
NameRooms = Callable[[Any, Mapping[str, SteadyName]], None]


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


class GraphLabeller:
    """Labels messages one after the other.

    A message that equals the one before it is labelled once, unless something would change.

    Parameters
    ----------
    codec : what reads graphs
    labeller : what answers their rooms
    names : what decides whether a room's name follows its answer
    name_rooms : what writes names into a graph
    complaints : what is told of messages that are dropped
    """

    def __init__(
        self,
        codec: Codec,
        labeller: Labeller,
        names: SteadyNames,
        name_rooms: NameRooms,
        complaints: Complaints | None = None,
    ) -> None:
        self._codec, self._labeller = codec, labeller
        self._names, self._name_rooms = names, name_rooms
        self._complain = complaints or Complaints()
        self.counters = Counters()
        self._message: bytes | None = None  # the last one that was labelled
        self._rooms: Mapping[str, Any] = {}  # its rooms
        self._answers: Mapping[str, Prediction] = {}  # their answers
        self._labelled = b""

    def take(self, message: bytes) -> bytes | None:
        """The labelled message; ``None`` where it had to be dropped."""
        started = time.perf_counter()
        self.counters.received += 1
        done = message == self._message and not (self._names.unsettled or self._labeller.unasked)
        if not done and not self._label(message, new=True):
            return None
        self.counters.published += 1
        self.counters.latencies.append(time.perf_counter() - started)
        return self._labelled

    def take_model_answers(self) -> bytes | None:
        """The last message with newer answers; ``None`` where the model has nothing new for it."""
        if not self._labeller.take_model_answers() or self._message is None:
            return None
        answers = self._labeller.label(self._rooms)
        if all(answer is self._answers[key] for key, answer in answers.items()):
            return None
        if not self._label(self._message, new=False):
            return None
        self.counters.published += 1
        return self._labelled

    def report(self) -> str:
        """The counters in a line, with what waits and what is not understood."""
        waiting, unknown = self._labeller.waiting, self._labeller.unknown_names.line()
        parts = [
            f"{waiting} question{'s' if waiting > 1 else ''} waiting" if waiting else "",
            unknown,
        ]
        return "; ".join([self.counters.line(), *filter(None, parts)])

    def close(self) -> None:
        """Let what runs in the background end."""
        self._labeller.close()

    def _label(self, message: bytes, new: bool) -> bool:
        try:
            scene = self._codec.decode(message)
            answers = self._labeller.label(scene.rooms)
            named = self._names.settle(scene, answers, new=new)
            self._name_rooms(scene, named)
            labelled = scene.encode()
        except Exception as error:  # a message from outside: there is no telling what it causes
            self._drop(message, error)
            return False
        self._message, self._labelled = message, labelled
        self._rooms, self._answers = scene.rooms, answers
        self.counters.rooms = Counter(_how(answers[key], named.get(key)) for key in answers)
        return True

    def _drop(self, message: bytes, error: Exception) -> None:
        self.counters.dropped += 1
        reason = str(error)
        if not isinstance(error, InputError):
            reason = (
                f"not a graph that can be labelled ({type(error).__name__}: {first_line(error)})"
            )
        self._complain(reason, f"dropped a message of {len(message)} bytes: {{}}")


def _how(answer: Prediction, named: SteadyName | None) -> str:
    """How a room was answered, for the counters."""
    if named is not None and named.held:
        return "held"
    if answer.room is None:
        return "unanswered"
    if named is None:
        return "left alone"
    if answer.backed_off:
        return "by back-off"
    return "by model" if answer.answered_by == LM else "from table"
