"""Rooms that the tables alone cannot answer: unlisted objects, and combinations that none holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from roomtables.labels import ObjectLabel
from roomtables.online import rules
from roomtables.online.decision import KnownObject, TableDecider
from roomtables.online.model import QueryModel
from roomtables.online.prediction import LM, NONE, TABLE, Prediction
from roomtables.schemas import ENTROPY_DECIMALS, PROXY
from roomtables.storage.misses import MissLog

# Beyond this length a string is no object's name, and beyond this many unlisted names a room is
# no room: the model is not asked about the rest.
_LONGEST_NAME = 100
_MOST_UNLISTED = 50


@dataclass
class Question:
    """A room on its way to an answer: ranks of listed objects, and names that no table knows."""

    ranks: Sequence[int]
    unlisted: Mapping[str, str]
    known: list[KnownObject] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)


class OpenVocabulary:
    """Answers what needs the language model, in batched passes, where there is one."""

    def __init__(
        self, decider: TableDecider, model: QueryModel, misses: MissLog | None = None
    ) -> None:
        self._decider = decider
        self._model = model
        self._misses = misses

    def can_ask(self) -> bool:
        """Whether an unlisted object can be ranked among the listed ones; loads the model."""
        proxy = self._decider.decision.source == PROXY
        return proxy and self._model.extends_tables and self._model.load() is not None

    def answer(self, questions: Sequence[Question]) -> list[Prediction]:
        """Predictions in the order of the questions, in two passes of the model at most."""
        asks = any(question.unlisted for question in questions) and self.can_ask()
        for question in questions:
            for spelled, name in question.unlisted.items():
                fits = len(spelled) <= _LONGEST_NAME and len(question.asked) < _MOST_UNLISTED
                (question.asked if asks and fits else question.unknown).append(
                    spelled if asks and fits else name
                )
        found = self._rank({spelled for question in questions for spelled in question.asked})
        for question in questions:
            listed = [self._decider.known_object(rank) for rank in question.ranks]
            asked = [found[spelled] for spelled in question.asked]
            question.known = sorted([*listed, *asked], key=lambda known: known.order)
        if self._decider.pools:
            return [self._pool(question) for question in questions]
        return self._query(questions)

    def _rank(self, names: set[str]) -> dict[str, KnownObject]:
        """Score the single-object sentences of unlisted names, in one pass, and rank them."""
        if not names:
            return {}
        lookup, candidates = self._decider.lookup, self._decider.candidates
        labels = {name: ObjectLabel.named(name) for name in sorted(names)}
        rooms = (*lookup.rooms, *(room for room in candidates.rooms if room not in lookup.rooms))
        scores = self._model.score([([label], rooms) for label in labels.values()]) or []
        columns = [rooms.index(room) for room in candidates.rooms]
        found = {}
        for (name, label), row in zip(labels.items(), scores, strict=True):
            over_rooms = rules.log_softmax(row[: len(lookup.rooms)])
            entropy = round(float(rules.entropy(over_rooms)), ENTROPY_DECIMALS)
            power = self._decider.decision.evidence_power
            adjusted = rules.adjusted(row[columns], candidates.bias, self._decider.prior_weight)
            weight = rules.evidence_weights(adjusted, power)
            evidence = rules.weighed(adjusted, weight)
            found[name] = KnownObject(label, (entropy, name), None, evidence, float(weight))
        return found

    def _pool(self, question: Question) -> Prediction:
        """Rule ``pooled``: the evidence of all the room's objects, summed."""
        if not question.known:
            return self._predict(question, None, NONE)
        compared = np.add.reduce([known.evidence for known in question.known], axis=0)
        return self._predict(question, compared, LM if question.asked else TABLE)

    def _query(self, questions: Sequence[Question]) -> list[Prediction]:
        """Rules ``query`` and ``calibrated``: the query sentence's scores, looked up or asked."""
        picked = [question.known[: self._decider.k] for question in questions]
        compared = [self._look_up(objects) for objects in picked]
        answered_by = [TABLE if row is not None else NONE for row in compared]
        missed = [at for at, row in enumerate(compared) if row is None and picked[at]]
        self._note_misses([picked[at] for at in missed])
        rooms = self._decider.candidates.rooms
        asked = [([known.label for known in picked[at]], rooms) for at in missed]
        answers = self._model.score(asked) if asked else None
        for at, scores in zip(missed, answers or [], strict=False):
            compared[at], answered_by[at] = self._decider.adjust(scores), LM
        return [
            self._predict(question, row, by)
            for question, row, by in zip(questions, compared, answered_by, strict=True)
        ]

    def _note_misses(self, missed: Sequence[Sequence[KnownObject]]) -> None:
        """Note combinations of listed objects, which a build can put into the tables."""
        if self._misses is not None and self._decider.candidates.in_tables:
            listed = [picked for picked in missed if all(known.rank for known in picked)]
            labels = [[known.label.label for known in picked] for picked in listed]
            self._misses.note(self._decider.decision.source, labels)

    def _look_up(self, picked: Sequence[KnownObject]) -> NDArray[np.floating] | None:
        ranks = [known.rank for known in picked if known.rank is not None]
        return self._decider.compare(ranks) if len(ranks) == len(picked) else None

    def _predict(
        self, question: Question, compared: NDArray[np.floating] | None, answered_by: str
    ) -> Prediction:
        names = self._decider.room_names
        # Rooms are sorted and argmax takes the first: a tie goes to the label that sorts first.
        room = None if compared is None else names[int(compared.argmax())]
        unknown = tuple(question.unknown)
        return Prediction(self._decider, room, answered_by, question.known, unknown, compared)
