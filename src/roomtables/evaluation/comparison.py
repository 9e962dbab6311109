"""The same rooms under several decisions: chosen conditions compared, or a grid of settings swept.

:func:`compare` judges a few (rule, source) conditions and tests, pair by pair, whether they differ
by more than chance. :func:`sweep` judges a grid of settings (k, λ, γ, rule, source) from the tables
alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from roomtables.errors import InputError
from roomtables.evaluation.judging import Evaluation, evaluate, room_list
from roomtables.evaluation.statistics import bootstrap_interval, mcnemar
from roomtables.online.classifier import RoomTables
from roomtables.online.model import QueryModel
from roomtables.online.rules import effective_prior_weight
from roomtables.rooms import Room
from roomtables.schemas import CALIBRATED, POOLED, QUERY, REDUCTIONS, RULES, SOURCES

PRIOR_WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""Values of λ that a sweep tries."""
EVIDENCE_POWERS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
"""Values of γ that a sweep tries."""


def parse_conditions(text: str) -> tuple[tuple[str, str], ...]:
    """``RULE:SOURCE,…`` as pairs, each once, in order.

    Raises
    ------
    InputError
        A part is not of that form, or names no rule or source.
    """
    found = []
    for part in text.split(","):
        rule, _, source = part.strip().partition(":")
        if rule not in RULES or source not in SOURCES:
            raise InputError(
                f"--compare: {part.strip()!r} is not RULE:SOURCE; rules are {', '.join(RULES)}, "
                f"sources {', '.join(SOURCES)}; for example `--compare query:proxy,pooled:proxy`"
            )
        found.append((rule, source))
    return tuple(dict.fromkeys(found))


def compare(
    rooms: Iterable[Room] | str | Path,
    tables: RoomTables,
    conditions: Sequence[tuple[str, str]],
    weights: str | None = None,
) -> Comparison:
    """Evaluate each (rule, source) on the same rooms; ``weights`` as for :func:`evaluate`.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    StoreError
        The tables hold no such source.
    """
    held = room_list(rooms)
    return Comparison(
        tuple(evaluate(held, tables.deciding(rule=r, source=s), weights) for r, s in conditions)
    )


@dataclass(frozen=True)
class Comparison:
    """Evaluations of the same rooms under several conditions, in the order asked for."""

    evaluations: tuple[Evaluation, ...]

    def paired_tests(self) -> list[PairedTest]:
        """Every two conditions, tested in pairs of rooms."""
        return [PairedTest.of(a, b) for a, b in combinations(self.evaluations, 2)]

    def as_json(self) -> dict[str, Any]:
        """All evaluations with their statistics, and the tests between them."""
        return {
            "conditions": [found.as_json(statistics=True) for found in self.evaluations],
            "paired_tests": [asdict(test) for test in self.paired_tests()],
        }


@dataclass(frozen=True)
class PairedTest:
    """Two conditions on the same rooms: the difference in accuracy, and whether it may be chance.

    ``difference`` is first less second, ``low`` and ``high`` its paired bootstrap interval;
    ``only_first``, ``only_second`` and ``p_value`` are as in McNemar's test.
    """

    first: str
    second: str
    difference: float
    low: float
    high: float
    only_first: int
    only_second: int
    p_value: float

    @classmethod
    def of(cls, first: Evaluation, second: Evaluation) -> PairedTest:
        """The test of two evaluations of the same rooms in the same order."""
        difference = first.outcomes.astype(np.float64) - second.outcomes
        interval = bootstrap_interval(difference)
        test = mcnemar(first.outcomes, second.outcomes)
        return cls(
            first.condition, second.condition, float(difference.mean()), interval.low,
            interval.high, test.only_first, test.only_second, test.p_value,
        )  # fmt: skip


def sweep(rooms: Iterable[Room] | str | Path, tables: RoomTables) -> Sweep:
    """Evaluate the rooms under every rule, source, λ, γ and k that the tables can answer.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    """
    held = room_list(rooms)
    model = QueryModel(tables.version.manifest, allowed=False)  # nor are its misses noted
    alone = replace(tables.decision, backoff=False)  # what each rule itself decides
    tables = RoomTables(tables.version, tables.lookup, model, alone)
    lookup = tables.lookup
    points: list[SweepPoint] = []
    notes: list[str] = []
    for source, arrays in lookup.sources.items():
        pooled = tables.deciding(rule=POOLED, source=source)
        by_k = _with_fewer_objects(held, pooled)
        points += _over_weights(held, pooled)
        points += [_point(fewer, pooled, k) for k, fewer in by_k.items()]
        if len(arrays.keys):
            points += _over_queries(by_k, tables.deciding(rule=QUERY, source=source))
        else:
            notes.append(
                f"rules {QUERY} and {CALIBRATED} with source {source}: the tables hold no "
                "combinations; run `roomtables build --combinations all`"
            )
    other = next(name for name in REDUCTIONS if name != lookup.reduction)
    notes.append(f"reduction {other}: run `roomtables build --reduction {other}`")
    notes.append(f"k above {lookup.k}: run `roomtables build -k {lookup.k + 1}`")
    return Sweep(tuple(points), tuple(notes))


@dataclass(frozen=True)
class Sweep:
    """All points, and one sentence for each thing that could not be varied."""

    points: tuple[SweepPoint, ...]
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """``{"sweep": [point, …], "notes": [sentence, …]}``."""
        return {"sweep": [asdict(point) for point in self.points], "notes": list(self.notes)}


@dataclass(frozen=True)
class SweepPoint:
    """One setting, and how many of the rooms it labels right.

    ``k`` is ``None`` where all of a room's objects count; ``prior_weight`` (λ) and
    ``evidence_power`` (γ) are ``None`` where they have no effect.
    """

    reduction: str
    source: str
    rule: str
    k: int | None
    prior_weight: float | None
    evidence_power: float | None
    rooms: int
    correct: int
    accuracy: float


def _over_weights(rooms: Sequence[Room], pooled: RoomTables) -> Iterator[SweepPoint]:
    """Rule ``pooled`` on all the rooms' objects: each λ that makes a difference, with each γ."""
    source = pooled.decision.source
    weights = dict.fromkeys(effective_prior_weight(source, weight) for weight in PRIOR_WEIGHTS)
    for weight, power in product(weights, EVIDENCE_POWERS):
        yield _point(rooms, pooled.deciding(prior_weight=weight, evidence_power=power), None)


def _over_queries(by_k: dict[int, list[Room]], queried: RoomTables) -> Iterator[SweepPoint]:
    """Rule ``query`` over k, and rule ``calibrated`` over k and λ."""
    for k, rooms in by_k.items():
        yield _point(rooms, queried, k)
        for weight in PRIOR_WEIGHTS:
            yield _point(rooms, queried.deciding(rule=CALIBRATED, prior_weight=weight), k)


def _with_fewer_objects(rooms: Sequence[Room], tables: RoomTables) -> dict[int, list[Room]]:
    """k = 1, 2, … to the rooms with no more than their k most informative objects.

    What a rule decides for those rooms is what tables built with that k would decide: the
    combinations of fewer objects are in the tables too.
    """
    picked = [p.objects for p in tables.classify_many([room.objects for room in rooms])]
    return {
        k: [
            # A room of nothing known stays a room: it is unanswered, not left out.
            Room(room.room_id, objects[:k] or room.objects, room.truth)
            for room, objects in zip(rooms, picked, strict=True)
        ]
        for k in range(1, tables.lookup.k + 1)
    }


def _point(rooms: Sequence[Room], tables: RoomTables, k: int | None) -> SweepPoint:
    """The rooms judged under the decision of ``tables``."""
    found = evaluate(rooms, tables)
    decision = tables.decision
    pools = decision.rule == POOLED
    calibrates = decision.rule == CALIBRATED or (
        pools and effective_prior_weight(decision.source, 1.0) > 0
    )
    return SweepPoint(
        tables.lookup.reduction,
        found.source,
        found.rule,
        k,
        decision.prior_weight if calibrates else None,
        decision.evidence_power if pools else None,
        found.rooms,
        found.correct,
        found.accuracy,
    )
