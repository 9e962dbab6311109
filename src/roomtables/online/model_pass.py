"""Rooms that the tables alone cannot answer: unlisted objects, and combinations that none holds.

On a miss, the combination is noted in the ``misses`` folder for the next build, and the language
model, where there is one, scores its query sentence for each candidate room, together with those of
all the other rooms that were asked about. Without a model rule ``pooled`` decides, from the tables
of single objects, unless the decision forbids that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roomtables.english import can_inflect
from roomtables.labels import ObjectLabel
from roomtables.names import as_spoken
from roomtables.online import rules
from roomtables.online.decider import Decider, UnlistedObject
from roomtables.online.model import QueryModel
from roomtables.online.prediction import LM, NONE, TABLE, Prediction
from roomtables.online.ranks import ABSENT, RankedRooms
from roomtables.schemas import PROXY
from roomtables.storage.miss_log import MissLog

# Limits on what one room may ask of the model; what is beyond them stays unknown.
_LONGEST_NAME = 100  # bytes, each of which may be a token
_MOST_UNLISTED = 50


class Question(NamedTuple):
    """A room to answer.

    Attributes
    ----------
    ranks : of its listed objects, ascending
    unlisted : names that no table lists: normalised → as given
    given : all the names
    """

    ranks: Sequence[int]
    unlisted: Mapping[str, str]
    given: tuple[str, ...]


class ModelPass:
    """Answers rooms with the language model's help, in batched passes, where there is one.

    Parameters
    ----------
    decider : the tables under a decision
    model : what scores sentences that no table holds
    misses : where combinations are noted that no table holds; ``None``: nowhere
    """

    def __init__(self, decider: Decider, model: QueryModel, misses: MissLog | None = None) -> None:
        self._decider = decider
        self._model = model
        self._misses = misses

    def ranks_unlisted(self) -> bool:
        """Whether unlisted objects can be ranked among the listed ones; loads the model.

        Only the model whose scores the tables hold can do that: another's are not comparable.
        """
        proxy = self._decider.decision.source == PROXY
        comparable = proxy and self._model.extends_tables
        return comparable and self.has_model()

    def has_model(self) -> bool:
        """Whether there is a model to ask; loads it."""
        return self._model.load() is not None

    def answer(self, asked: Iterable[Question]) -> list[Prediction]:
        """Predictions in the order of the questions, in two passes of the model at most."""
        questions = list(asked)
        names = [_askable(question.unlisted.values()) for question in questions]
        if not (any(names) and self.ranks_unlisted()):
            names = [[] for _ in questions]
        ranked = self._rank({name for of_room in names for name in of_room})
        rooms = [
            self._unanswered(question, {name: ranked[name] for name in of_room if name in ranked})
            for question, of_room in zip(questions, names, strict=True)
        ]
        return [self._pool(room) for room in rooms] if self._decider.pools else self._query(rooms)

    def back_off(self, question: Question) -> Prediction:
        """The answer that a room gets without a model; its miss is not noted once more."""
        return self._back_off(self._unanswered(question, {}))

    def back_off_many(self, missed: RankedRooms) -> NDArray[np.int64]:
        """The number of the best candidate of rooms that no table answers, without a model.

        Their misses are noted; ``ABSENT`` where the decision forbids to back off.
        """
        decider = self._decider
        picked = missed.most_informative(decider.lookup.k).tolist()
        self._note([[decider.label(rank).label for rank in row if rank] for row in picked])
        backoff = decider.backoff
        return np.full(len(picked), ABSENT) if backoff is None else backoff.best_of_many(missed)

    def _rank(self, names: Iterable[str]) -> dict[str, UnlistedObject]:
        """Score the single-object sentences of unlisted names, in one pass, and rank them."""
        lookup, candidates = self._decider.lookup, self._decider.candidates
        labels = [ObjectLabel.named(name) for name in sorted(names)]
        rooms = (*lookup.rooms, *(room for room in candidates.rooms if room not in lookup.rooms))
        scores = self._model.score_singles(labels, rooms, lookup.rooms) if labels else None
        columns = [rooms.index(room) for room in candidates.rooms]
        ranked = {}
        for label, logits in zip(labels, scores or (), strict=True):
            entropy = rules.entropy(rules.log_softmax(logits[: len(lookup.rooms)]))
            key = rules.rank_key(float(entropy), label.label)
            ranked[label.label] = UnlistedObject(label, key, logits[columns])
        return ranked

    def _unanswered(self, question: Question, ranked: Mapping[str, UnlistedObject]) -> Prediction:
        names = question.unlisted.values()
        unknown = tuple(name for name in names if as_spoken(name) not in ranked)
        unlisted = tuple(ranked.values())
        return Prediction(
            self._decider, None, NONE, question.ranks, question.given, unknown, unlisted=unlisted
        )

    def _pool(self, room: Prediction) -> Prediction:
        """Rule ``pooled``: the evidence of all the room's objects, added up."""
        if not (room.ranks or room.unlisted):
            return room
        compared = self._decider.weigh(room.ranks, room.unlisted).compared
        return room.answered(compared, LM if room.unlisted else TABLE)

    def _query(self, rooms: Sequence[Prediction]) -> list[Prediction]:
        """Rules ``query`` and ``calibrated``: the query sentence's scores, looked up or asked."""
        answers = [self._look_up(room) for room in rooms]
        missed = [at for at, room in enumerate(rooms) if room is answers[at] and room.objects]
        self._note([rooms[at].objects for at in missed if _picks_listed(rooms[at])])
        candidates = self._decider.candidates.rooms
        sentences = [
            (self._decider.pick(rooms[at].ranks, rooms[at].unlisted), candidates) for at in missed
        ]
        scores = self._model.score(sentences) if sentences else None
        for place, at in enumerate(missed):
            if scores is None:
                answers[at] = self._back_off(rooms[at])
            else:
                answers[at] = rooms[at].answered(self._decider.calibrate(scores[place]), LM)
        return answers

    def _back_off(self, room: Prediction) -> Prediction:
        backoff = self._decider.backoff
        return room if backoff is None else room.backed_off_by(backoff)

    def _look_up(self, room: Prediction) -> Prediction:
        """The room answered from the tables, or as it was where they lack the combination."""
        compared = self._decider.compare(room.ranks) if _picks_listed(room) else None
        return room if compared is None else room.answered(compared, TABLE)

    def _note(self, combinations: Iterable[Sequence[str]]) -> None:
        """Note combinations of listed objects, which a build can put into the tables."""
        if self._misses is not None and self._decider.candidates.in_tables:
            self._misses.note(self._decider.decision.source, combinations)


def _picks_listed(room: Prediction) -> bool:
    """Whether the picked objects are all listed, so that a table may hold their combination."""
    return {named.label.label for named in room.unlisted}.isdisjoint(room.objects)


def _askable(unlisted: Iterable[str]) -> list[str]:
    """The unlisted names of a room that the model is asked about, as a sentence says them.

    The sentence needs their plurals. Where there are too many, in whatever order they are given, it
    is asked about the same ones.
    """
    names = {as_spoken(name) for name in unlisted if _is_short(name)}
    spoken = sorted(name for name in names if any(map(str.isalpha, name)))
    return [name for name in spoken if can_inflect(name)][:_MOST_UNLISTED]


def _is_short(name: str) -> bool:
    return len(name.encode(errors="replace")) <= _LONGEST_NAME
