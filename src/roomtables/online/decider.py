"""Tables under one decision: what the rule compares, and what each object adds to it.

To add a rule, name it in ``schemas.RULES``, put its formula into ``rules.py``, and say here what it
compares: :meth:`Decider.compare` for one room, :meth:`Decider.best_of_many` for many at once. Its
SQL is a macro in ``pipeline/macros``, with a line in ``decided.sql``;
``tests/unit/online/test_one_truth.py`` holds all of them equal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import ObjectLabel
from roomtables.names import NameReader
from roomtables.online import rules
from roomtables.online.decision import Candidates, Decision
from roomtables.online.model import QueryModel
from roomtables.online.names import UNLISTED, Vocabulary
from roomtables.online.ranks import ABSENT, RankedRooms, ScoreRows
from roomtables.schemas import CALIBRATED, POOLED
from roomtables.storage.lookup import Lookup


@dataclass(frozen=True, slots=True)
class UnlistedObject:
    """An object that no table lists, as the model scores it.

    Attributes
    ----------
    label : its name, and its plural
    rank_key : where it stands among objects, see :func:`~roomtables.online.rules.rank_key`
    room_logits : ``[candidates]``, S(o, r) in nats
    """

    label: ObjectLabel
    rank_key: tuple[float, str]
    room_logits: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WeighedObjects:
    """A room's objects under rule ``pooled``, most informative first.

    Attributes
    ----------
    labels : the objects
    weights : ``[objects]``, w(o)
    evidence : ``[objects, candidates]``, w(o) L′(o, r) in nats
    """

    labels: tuple[str, ...]
    weights: NDArray[np.float64]
    evidence: NDArray[np.float64]

    @property
    def compared(self) -> NDArray[np.float64]:
        """What rule ``pooled`` compares: the evidence added up, ``[candidates]`` in nats."""
        total: NDArray[np.float64] = np.add.reduce(self.evidence, axis=0)
        return total


class Decider:
    """A source's tables under a decision. Nothing in it changes, so threads may share it.

    A listed object is known by its rank in the source, from 1 (most informative).

    Attributes
    ----------
    decision : how to decide
    lookup : the tables
    candidates : the rooms that may be the answer
    vocabulary : name → rank
    pools : whether the rule is ``pooled``, which takes all objects and needs no query sentence
    """

    def __init__(
        self, lookup: Lookup, decision: Decision, candidates: Candidates, vocabulary: Vocabulary
    ) -> None:
        self.decision = decision
        self.lookup = lookup
        self.candidates = candidates
        self.vocabulary = vocabulary
        self.pools = decision.rule == POOLED
        self._arrays = lookup.sources[decision.source]
        self._rows = ScoreRows(self._arrays, lookup.k, candidates.columns)
        # rank - 1 → number of the object
        self._numbers: list[int] = np.argsort(self._arrays.ranks).tolist()
        calibrates = decision.rule == CALIBRATED
        self._offset = decision.prior_weight * candidates.bias if calibrates else None

    @classmethod
    def choose(
        cls, lookup: Lookup, decision: Decision, model: QueryModel, reader: NameReader
    ) -> Decider:
        """The tables of the decision's source, and its candidate rooms.

        Raises
        ------
        StoreError
            The tables hold no such source.
        InputError
            A candidate room is unknown and no model may be asked about it.
        """
        if decision.source not in lookup.sources:
            raise StoreError(
                f"the tables of {model.labels} hold no source {decision.source!r} "
                f"(only {', '.join(lookup.sources)}); run `roomtables build --counts FILE.csv`"
            )
        candidates = Candidates.choose(lookup, decision.source, decision.rooms, model)
        labels = (listed.label for listed in lookup.objects)
        ranks = zip(labels, lookup.sources[decision.source].ranks.tolist(), strict=True)
        return cls(lookup, decision, candidates, Vocabulary(reader, dict(ranks)))

    @cached_property
    def backoff(self) -> Decider | None:
        """Decides by rule ``pooled`` where this one lacks a row; ``None`` if that is not wanted."""
        if self.pools or not self.decision.backoff:
            return None
        pooled = replace(self.decision, rule=POOLED)
        return BackoffDecider(self.lookup, pooled, self.candidates, self.vocabulary)

    def read_as(self, names: Iterable[str]) -> dict[str, str]:
        """The objects that names stand for, by name, but for names that are the labels."""
        ranked = ((name, self.vocabulary[name]) for name in names)
        labels = {name: self.label(rank).label for name, rank in ranked if rank != UNLISTED}
        return {name: label for name, label in labels.items() if name != label}

    def compare(self, ranks: Sequence[int]) -> NDArray[np.floating] | None:
        """What the rule compares for listed objects, their ranks ascending: ``[candidates]``, nats.

        ``None`` where there is no object, or where no table holds the combination of the k first.
        """
        if not ranks:
            return None
        if self.pools:
            pooled: NDArray[np.float64] = np.add.reduce(self._evidence.take(ranks, 0), 0)
            return pooled
        row = self._rows.find(ranks) if self.candidates.in_tables else ABSENT
        return None if row == ABSENT else self.calibrate(self._rows.scores(row))

    def best_of_many(self, rooms: RankedRooms) -> NDArray[np.int64]:
        """The number of the best candidate for each room; ``ABSENT`` as :meth:`compare` is None."""
        best = np.full(len(rooms.lengths), ABSENT)
        for places, part in rooms.parts():
            if self.pools:
                pooled, summed = part.summed(self._evidence)
                best[places] = np.where(summed, pooled.argmax(axis=1), ABSENT)
            elif self.candidates.in_tables:
                rows = self._rows.find_many(part.most_informative(self.lookup.k))
                present = np.flatnonzero(rows != ABSENT)
                compared = self.calibrate(self._rows.scores_many(rows[present]))
                best[places][present] = compared.argmax(axis=1)
        return best

    def calibrate(self, scores: NDArray[np.floating]) -> NDArray[np.floating]:
        """What rules ``query`` and ``calibrated`` compare of a sentence's scores: S, or S − λ b."""
        return scores if self._offset is None else scores - self._offset

    def best_room(self, compared: NDArray[np.floating]) -> str:
        """The candidate with the highest number; a tie goes to the label that sorts first."""
        # Candidates are sorted by label, and argmax takes the first of equals.
        return self.candidates.names[compared.argmax()]

    def pick(self, ranks: Sequence[int], unlisted: Sequence[UnlistedObject]) -> list[ObjectLabel]:
        """The k most informative objects, in the order in which a query sentence names them."""
        keyed = [(self._rank_key(rank), self.label(rank)) for rank in ranks[: self.lookup.k]]
        keyed += [(named.rank_key, named.label) for named in unlisted]
        return [label for _, label in sorted(keyed, key=lambda pair: pair[0])[: self.lookup.k]]

    def weigh(
        self,
        ranks: Sequence[int],
        unlisted: Sequence[UnlistedObject] = (),
        factors: Mapping[str, float] | None = None,
    ) -> WeighedObjects:
        """What each object adds under rule ``pooled``; ``factors`` of their weights, by label."""
        room_logits = self.candidates.room_logits
        keyed = [(self._rank_key(rank), room_logits[self._numbers[rank - 1]]) for rank in ranks]
        keyed += [(named.rank_key, named.room_logits) for named in unlisted]
        keyed.sort(key=lambda pair: pair[0])
        labels = tuple(label for (_, label), _ in keyed)
        logits = np.array([row for _, row in keyed]).reshape(-1, room_logits.shape[1])
        adjusted, weights = self._adjusted_and_weights(logits)
        if factors:
            weights = weights * np.array([factors.get(label, 1.0) for label in labels])
        return WeighedObjects(labels, weights, rules.evidence(adjusted, weights))

    @cached_property
    def _evidence(self) -> NDArray[np.float64]:
        """What each listed object adds under rule ``pooled``, ``[1 + rank, candidates]``."""
        by_number = rules.evidence(*self._adjusted_and_weights(self.candidates.room_logits))
        evidence = np.zeros((1 + len(by_number), len(self.candidates.names)))
        evidence[self._arrays.ranks] = by_number
        return evidence

    def _adjusted_and_weights(
        self, room_logits: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """L′ ``[objects, candidates]`` and w(o) ``[objects]``, from S(o, r)."""
        decision = self.decision
        weight = rules.effective_prior_weight(decision.source, decision.prior_weight)
        adjusted = rules.adjusted(room_logits, self.candidates.bias, weight)
        return adjusted, rules.evidence_weights(adjusted, decision.evidence_power)

    def label(self, rank: int) -> ObjectLabel:
        """The listed object of a rank."""
        return self.lookup.objects[self._numbers[rank - 1]]

    def _rank_key(self, rank: int) -> tuple[float, str]:
        number = self._numbers[rank - 1]
        return rules.rank_key(float(self._arrays.entropy[number]), self.label(rank).label)


class BackoffDecider(Decider):
    """Stands in, by rule ``pooled``, for a decider whose tables lack a combination."""
