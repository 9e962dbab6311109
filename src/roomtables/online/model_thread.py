"""A thread that asks the language model about rooms, many at a time, while a service goes on.

A question that the model fails at is asked again after a pause; the others are not held up by it.
Only a model that does not load is not asked again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import islice

from roomtables.errors import first_line
from roomtables.online.classifier import RoomTables
from roomtables.online.complaints import Complaints
from roomtables.online.prediction import Prediction

log = logging.getLogger(__name__)

_MOST_WAITING = 4_096  # questions
_BATCH = 64  # questions in one pass of the model
_LONGEST_PAUSE = 60.0  # seconds; the first pause is given, each further one is twice as long
_MOST_DOUBLED = 20  # failures after which the pause grows no more


@dataclass(slots=True)
class _Failed:
    """A question that the model failed at: how often, and when it is due again."""

    names: Sequence[str]
    failures: int
    due: float


class ModelThread:
    """Asks the language model in the background. The thread starts with the first question.

    Parameters
    ----------
    tables : opened with the language model allowed
    complaints : what is told of failures
    first_pause : seconds until a question that the model failed at is asked again
    most_waiting : questions that wait for their first answer, at most; as many may have failed
    """

    def __init__(
        self,
        tables: RoomTables,
        complaints: Complaints | None = None,
        first_pause: float = 1.0,
        most_waiting: int = _MOST_WAITING,
    ) -> None:
        self._tables = tables
        self._complain = complaints or Complaints()
        self._first_pause = first_pause
        self._most_waiting = most_waiting
        self._changed = threading.Condition()
        self._waiting: OrderedDict[Hashable, Sequence[str]] = OrderedDict()
        self._failed: OrderedDict[Hashable, _Failed] = OrderedDict()
        self._answers: list[tuple[Hashable, Prediction]] = []
        self._thread: threading.Thread | None = None
        self._ended = False

    @property
    def ended(self) -> bool:
        """Whether no question will be answered any more: it was closed, or no model loads."""
        return self._ended

    @property
    def waiting(self) -> int:
        """How many questions have no answer yet."""
        return len(self._waiting) + len(self._failed)

    def ask(self, key: Hashable, names: Sequence[str]) -> bool:
        """Have a room's objects asked about, unless they wait already; False where none fits in."""
        with self._changed:
            if self._ended:
                return False
            if key in self._waiting or key in self._failed:
                return True
            if len(self._waiting) >= self._most_waiting:
                behind = len(self._waiting)
                self._complain(f"the model is {behind} questions behind; more are asked later")
                return False
            self._waiting[key] = names
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="model", daemon=True)
                self._thread.start()
            self._changed.notify()
            return True

    def take_answers(self) -> list[tuple[Hashable, Prediction]]:
        """What the model has answered since the last call, by the questions' keys."""
        if not self._answers:
            return []
        with self._changed:
            answers, self._answers = self._answers, []
        return answers

    def close(self) -> None:
        """Let the thread end with the pass it is at."""
        with self._changed:
            self._end()

    def _end(self) -> None:
        self._ended = True
        self._waiting.clear()
        self._failed.clear()
        self._changed.notify()

    def _run(self) -> None:
        """The thread's work, until close or a model that does not load."""
        try:
            loaded = self._tables.load_model()  # where there is none, it has said so
        except Exception as error:
            log.warning("no language model (%s)", first_line(error))
            loaded = False
        if not loaded:
            self.close()
        while batch := self._next_batch():
            self._answer(batch)

    def _next_batch(self) -> list[tuple[Hashable, Sequence[str]]]:
        """Questions to ask together, once there are any; empty after close.

        One that has failed before is asked alone, when it is due and no other waits.
        """
        with self._changed:
            while not self._ended:
                if self._waiting:
                    return list(islice(self._waiting.items(), _BATCH))
                now = time.monotonic()
                next_due = min((asked.due for asked in self._failed.values()), default=None)
                if next_due is not None and next_due <= now:
                    return [
                        (key, asked.names)
                        for key, asked in self._failed.items()
                        if asked.due == next_due
                    ][:1]
                self._changed.wait(None if next_due is None else next_due - now)
            return []

    def _answer(self, batch: list[tuple[Hashable, Sequence[str]]]) -> None:
        """Answer questions in one pass, or if that fails in one pass each."""
        try:
            answers = list(self._tables.classify_many([names for _, names in batch]))
        except Exception as error:  # whatever a question makes of the model ends that one alone
            if len(batch) == 1:
                self._ask_again(*batch[0], error)
                return
            for pair in batch:
                if not self._ended:
                    self._answer([pair])
            return
        with self._changed:
            for (key, _), answer in zip(batch, answers, strict=True):
                self._forget(key)
                self._answers.append((key, answer))

    def _ask_again(self, key: Hashable, names: Sequence[str], error: Exception) -> None:
        """Ask again after a pause."""
        with self._changed:
            known = self._failed.get(key)
            failures = known.failures if known is not None else 0
            pause = min(self._first_pause * 2**failures, _LONGEST_PAUSE)
            self._forget(key)
            if not self._ended:
                again = _Failed(names, min(failures + 1, _MOST_DOUBLED), time.monotonic() + pause)
                self._failed[key] = again
            if len(self._failed) > self._most_waiting:
                self._failed.popitem(last=False)  # asked when its room is seen again
        self._complain(
            f"the model failed ({type(error).__name__}: {first_line(error)})",
            f"{{}}; what it was asked about is asked again in {pause:g} s",
        )

    def _forget(self, key: Hashable) -> None:
        self._waiting.pop(key, None)
        self._failed.pop(key, None)
