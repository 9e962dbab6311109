"""Tables under one decision: what the rule compares for the objects of a room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from roomtables.config import check_decision
from roomtables.errors import ConfigError, InputError, StoreError
from roomtables.labels import ObjectLabel, RoomLabel, normalise
from roomtables.online import rules
from roomtables.online.batch import ABSENT, ScoreRows
from roomtables.online.model import QueryModel
from roomtables.schemas import CALIBRATED, ENTROPY_DECIMALS, POOLED, PROXY, RULES
from roomtables.storage.lookup import Lookup

AUTO: Literal["auto"] = "auto"


@dataclass(frozen=True)
class Decision:
    """How to decide: the rule, whose co-occurrence, λ, γ, and the candidate rooms (all: none).

    ``temperature`` divides what the rule compares before it becomes probabilities; ``auto`` is the
    sum of the objects' weights under rule ``pooled``, 1 under others. A room whose answer is less
    probable than ``min_probability`` gets none.

    Raises
    ------
    ConfigError
        There is no such rule, or a number makes no sense.
    """

    rule: str
    source: str
    prior_weight: float
    evidence_power: float
    rooms: tuple[str, ...] = ()
    temperature: float | Literal["auto"] = 1.0
    min_probability: float = 0.0

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ConfigError(f"no rule {self.rule!r}; use one of {', '.join(RULES)}")
        check_decision(self.prior_weight, self.evidence_power)
        if self.temperature != AUTO and not 0 < self.temperature < float("inf"):
            raise ConfigError(f"temperature must be above 0 or `auto`, not {self.temperature}")
        if not 0 <= self.min_probability <= 1:
            raise ConfigError(f"min probability must be from 0 to 1, not {self.min_probability}")
        object.__setattr__(self, "rooms", tuple(self.rooms))


@dataclass(frozen=True, slots=True)
class KnownObject:
    """An object of a room as a rule sees it.

    Attributes
    ----------
    label : the object
    order : entropy (rounded) and label: what objects are ranked by
    rank : its rank in the tables, from 1; ``None`` for one that only the model knows
    evidence : ``[candidates]``, what it adds to each room under rule ``pooled``
    weight : w(o), the factor in it
    """

    label: ObjectLabel
    order: tuple[float, str]
    rank: int | None
    evidence: NDArray[np.float64]
    weight: float


class TableDecider:
    """A source's tables under a decision; nothing in it changes, so threads may share it.

    Raises
    ------
    StoreError
        The tables hold no such source.
    InputError
        A candidate room is unknown and no model may be asked about it.
    """

    def __init__(self, lookup: Lookup, decision: Decision, model: QueryModel) -> None:
        if decision.source not in lookup.sources:
            raise StoreError(
                f"the tables of {model.labels} hold no source {decision.source!r} "
                f"(only {', '.join(lookup.sources)}); run `roomtables build --counts FILE.csv`"
            )
        self.lookup = lookup
        self.decision = decision
        self.k = lookup.k
        self.pools = decision.rule == POOLED
        self.arrays = lookup.sources[decision.source]
        self.candidates = Candidates.choose(lookup, decision.source, decision.rooms, model)
        self.room_names = self.candidates.names
        self._rows = ScoreRows(self.arrays, lookup.k, self.candidates.columns)
        self._offset = (
            decision.prior_weight * self.candidates.bias if decision.rule == CALIBRATED else None
        )
        self._by_rank = np.argsort(self.arrays.ranks).tolist()  # rank - 1 → number of the object

    @property
    def prior_weight(self) -> float:
        """λ as it acts on evidence: counts have no taste in rooms to take away."""
        return self.decision.prior_weight if self.decision.source == PROXY else 0.0

    @cached_property
    def evidence(self) -> NDArray[np.float64]:
        """What each object adds to each room under rule ``pooled``, ``[1 + rank, candidates]``."""
        by_number = rules.weighed(self._adjusted, self._weights)
        evidence = np.zeros((1 + len(by_number), len(self.candidates.names)))
        evidence[self.arrays.ranks] = by_number
        return evidence

    @cached_property
    def _adjusted(self) -> NDArray[np.float64]:
        """L′, ``[objects, candidates]``."""
        found = self.candidates
        return rules.adjusted(found.room_logits, found.bias, self.prior_weight)

    @cached_property
    def _weights(self) -> NDArray[np.float64]:
        """w(o), ``[objects]``."""
        return rules.evidence_weights(self._adjusted, self.decision.evidence_power)

    def ranks(self) -> dict[str, int]:
        """Object label → rank."""
        labels = (o.label for o in self.lookup.objects)
        return dict(zip(labels, self.arrays.ranks.tolist(), strict=True))

    def known_object(self, rank: int) -> KnownObject:
        """The object of a rank."""
        number = self._by_rank[rank - 1]
        label = self.lookup.objects[number]
        entropy = round(float(self.arrays.entropy[number]), ENTROPY_DECIMALS)
        weight = float(self._weights[number])
        return KnownObject(label, (entropy, label.label), rank, self.evidence[rank], weight)

    def holds(self, ranks: Sequence[int]) -> bool:
        """Whether the tables hold the combination of the ``k`` best of these ranks, ascending."""
        return self._rows.find(ranks) != ABSENT

    def compare(self, ranks: Sequence[int]) -> NDArray[np.floating] | None:
        """What the rule compares for objects of these ranks, ascending: ``[candidates]``, nats.

        ``None`` where no table holds it.
        """
        if self.pools:
            if not ranks:
                return None
            pooled: NDArray[np.float64] = np.add.reduce(self.evidence.take(ranks, 0), 0)
            return pooled
        if not ranks or not self.candidates.in_tables:
            return None
        row = self._rows.find(ranks)
        return None if row == ABSENT else self.adjust(self._rows.scores(row))

    def best_of_many(self, ranks: NDArray[np.int64]) -> NDArray[np.int64]:
        """The best candidate for each combination ``[n, k]``; −1 where no table holds it."""
        best = np.full(len(ranks), ABSENT)
        if self.candidates.in_tables:
            rows = self._rows.find_many(ranks)
            held = np.flatnonzero(rows != ABSENT)
            best[held] = self.adjust(self._rows.scores_many(rows[held])).argmax(axis=1)
        return best

    def adjust(self, scores: NDArray[np.floating]) -> NDArray[np.floating]:
        """Query scores as rules ``query`` and ``calibrated`` compare them: S, or S − λ b."""
        return scores if self._offset is None else scores - self._offset


@dataclass(frozen=True)
class Candidates:
    """The candidate rooms, sorted by label.

    Attributes
    ----------
    rooms : the rooms
    names : their labels
    in_tables : whether the tables hold scores of all of them
    columns : their columns of the query scores; ``None`` for all columns, or if not in tables
    room_logits : ``[objects, candidates]``, nats, as :class:`~roomtables.lookup.SourceArrays`
    bias : ``[candidates]``, b in nats
    """

    rooms: tuple[RoomLabel, ...]
    names: tuple[str, ...]
    in_tables: bool
    columns: NDArray[np.intp] | None
    room_logits: NDArray[np.float64]
    bias: NDArray[np.float64]

    @classmethod
    def choose(
        cls, lookup: Lookup, source: str, names: Sequence[str], model: QueryModel
    ) -> Candidates:
        """All predicted rooms, or those named; the model is asked about rooms in no table.

        Raises
        ------
        InputError
            A name is empty, names a room that is never predicted, or names one that no table
            knows where no model may be asked.
        """
        rooms = _chosen(lookup, names)
        predicted = [number for number, room in enumerate(lookup.rooms) if room.predicted]
        places = {lookup.rooms[number].label: place for place, number in enumerate(predicted)}
        labels = tuple(room.label for room in rooms)
        if not all(label in places for label in labels):
            room_logits = _ask_about_rooms(lookup, source, rooms, model)
            return cls(rooms, labels, False, None, room_logits, rules.room_bias(room_logits))
        columns = np.array([places[label] for label in labels])
        arrays = lookup.sources[source]
        room_logits = np.ascontiguousarray(arrays.room_logits[:, predicted][:, columns])
        everything = len(columns) == len(predicted)
        return cls(
            rooms, labels, True, None if everything else columns, room_logits, arrays.bias[columns]
        )


def _chosen(lookup: Lookup, names: Sequence[str]) -> tuple[RoomLabel, ...]:
    if not names:
        return tuple(room for room in lookup.rooms if room.predicted)
    by_label = {room.label: room for room in lookup.rooms}
    chosen = {}
    for name in names:
        label = lookup.room_aliases.get(normalise(name), normalise(name))
        if not label:
            raise InputError("an empty room name among `--rooms`; write `--rooms kitchen,office`")
        chosen[label] = by_label.get(label) or RoomLabel.named(label)
    return tuple(chosen[label] for label in sorted(chosen))


def _ask_about_rooms(
    lookup: Lookup, source: str, rooms: tuple[RoomLabel, ...], model: QueryModel
) -> NDArray[np.float64]:
    """S(o, r) for candidates of which some are in no table, ``[objects, candidates]``."""
    unlisted = [room.label for room in rooms if room not in lookup.rooms]
    unpredicted = [room.label for room in rooms if not room.predicted]
    if unpredicted and not unlisted:
        raise InputError(
            f"room {unpredicted[0]!r} is never predicted in label space "
            f"{model.labels}; leave it out of `--rooms`"
        )
    usable = source == PROXY and model.extends_tables
    scores = model.score([([o], rooms) for o in lookup.objects]) if usable else None
    if scores is None:
        raise InputError(
            f"no table knows room {unlisted[0]!r}, and there is no model to ask; add it to "
            "rooms.csv and run `roomtables build`, or leave it out of `--rooms`"
        )
    return np.stack(scores)
