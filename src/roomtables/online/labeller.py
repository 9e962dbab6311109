"""Answers a running robot's rooms at once, from the tables; the language model's come later."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables
from roomtables.online.complaints import shortened
from roomtables.online.model_thread import ModelThread
from roomtables.online.prediction import NONE, Prediction

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")

_MOST_ANSWERS = 8_192  # remembered, by a room's objects, and again those of the model
_MOST_NAMES = 1_000  # unknown ones that are counted
_LONGEST_NAME = 40  # characters of a name that are shown


@dataclass(slots=True)
class _Known:
    """What is known of a set of objects: the answer, and what the model is still to be asked."""

    answer: Prediction
    question: Hashable | None


class Labeller:
    """Answers rooms; the answer to the same objects is remembered.

    Where the tables hold no row for a room's objects, or do not know one of their names, the room
    is answered by what the tables have, and the language model is asked, if there is one: the same
    that `RoomTables.classify` asks, only later. What does not fit among the waiting questions is
    asked when the room is seen again.

    Parameters
    ----------
    tables : opened offline
    model : what asks the same tables with the language model allowed, or ``None``
    suggest : names that tables know and that look like a given one, best first
    """

    def __init__(
        self,
        tables: RoomTables,
        model: ModelThread | None = None,
        suggest: Callable[[str], Sequence[str]] | None = None,
    ) -> None:
        self._tables = tables
        self._model = model
        self._answers: OrderedDict[frozenset[str], _Known] = OrderedDict()
        self._model_answers: OrderedDict[Hashable, Prediction] = OrderedDict()
        self.unknown_names = UnknownNames(suggest)
        self.unasked = False

    @property
    def waiting(self) -> int:
        """How many questions wait for the model."""
        return 0 if self._model is None else self._model.waiting

    def label(self, rooms: Mapping[str, Iterable[str]]) -> dict[str, Prediction]:
        """The answer for each room, by id.

        Afterwards ``unasked`` says whether a question about one of them had no place, so that they
        should be labelled again.
        """
        self.unasked = False
        return {key: self._answer(frozenset(objects)) for key, objects in rooms.items()}

    def take_model_answers(self) -> bool:
        """Take over what the language model has answered since; whether there was anything."""
        answers = self._model.take_answers() if self._model is not None else []
        for question, answer in answers:
            _remember(self._model_answers, question, answer)
        return bool(answers)

    def close(self) -> None:
        """Let the model's thread end with the pass it is at."""
        if self._model is not None:
            self._model.close()

    def _answer(self, objects: frozenset[str]) -> Prediction:
        known = self._answers.get(objects)
        if known is None:
            known = self._decide(objects)
            _remember(self._answers, objects, known)
        else:
            self._answers.move_to_end(objects)
        if known.question is not None and self._model is not None:
            self._ask(known, objects, self._model)
        return known.answer

    def _decide(self, objects: frozenset[str]) -> _Known:
        """What the tables say, and what is to be asked of the model: what `classify` asks it."""
        names = sorted(objects)
        answer = self._tables.classify(names)
        self.unknown_names.count(answer.unknown_objects)
        missed = answer.backed_off or answer.answered_by == NONE
        if not names or not (missed or answer.unknown_objects):
            return _Known(answer, None)
        # Names that are read alike make the same question.
        return _Known(
            answer, (tuple(answer.ranks), frozenset(map(normalise, answer.unknown_objects)))
        )

    def _ask(self, known: _Known, objects: frozenset[str], model: ModelThread) -> None:
        """Take the model's answer where there is one by now; else see that it is asked."""
        answer = self._model_answers.get(known.question)
        if answer is not None:
            known.answer, known.question = answer, None
        elif not model.ended and not model.ask(known.question, sorted(objects)):
            self.unasked = not model.ended


def _remember(memory: OrderedDict[Key, Value], key: Key, value: Value) -> None:
    """Put a value into a memory; the one that was used least recently makes room for it."""
    memory[key] = value
    if len(memory) > _MOST_ANSWERS:
        memory.popitem(last=False)


class UnknownNames:
    """Counts names that no table knows, one for each set of objects that a room was seen with.

    Parameters
    ----------
    suggest : names that tables know and that look like a given one, best first
    """

    def __init__(self, suggest: Callable[[str], Sequence[str]] | None = None) -> None:
        self._suggest = suggest or (lambda name: ())
        self._counts: Counter[str] = Counter()

    def count(self, names: Iterable[str]) -> None:
        """Count each name once; the rarest are forgotten where there are too many."""
        self._counts.update(name[: 2 * _LONGEST_NAME] for name in names)
        if len(self._counts) > _MOST_NAMES:
            self._counts = Counter(dict(self._counts.most_common(_MOST_NAMES // 2)))

    def line(self, most: int = 5) -> str:
        """The most frequent names, each with a name that the tables know; empty if there are none.

        An example: ``2 unknown names: settee 12 (sofa?), zorb 3``.
        """
        if not self._counts:
            return ""
        ordered = sorted(self._counts.items(), key=lambda pair: (-pair[1], pair[0]))
        shown = ", ".join(self._entry(name, count) for name, count in ordered[:most])
        number = len(self._counts)
        more = ", …" if number > most else ""
        return f"{number} unknown name{'s' if number > 1 else ''}: {shown}{more}"

    def _entry(self, name: str, count: int) -> str:
        nearest = next(iter(self._suggest(name)), None)
        return f"{shortened(name, _LONGEST_NAME)} {count}" + (f" ({nearest}?)" if nearest else "")
