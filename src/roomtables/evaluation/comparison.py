"""Several rules and sources on the same rooms: how each does, and whether they really differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from roomtables.errors import InputError
from roomtables.evaluation.judging import Evaluation, evaluate
from roomtables.evaluation.reduction import with_other_reduction
from roomtables.evaluation.statistics import bootstrap_interval, mcnemar
from roomtables.online.classifier import RoomTables
from roomtables.online.model import QueryModel
from roomtables.rooms import Room, read_room_lines
from roomtables.schemas import CALIBRATED, POOLED, PROXY, QUERY, RULES, SOURCES


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


@dataclass(frozen=True)
class PairedTest:
    """Two conditions on the same rooms: the difference in accuracy, and what luck explains of it.

    ``difference`` is first less second, with its paired bootstrap interval.
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
        """The test of two evaluations of the same rooms."""
        difference = first.outcomes.astype(np.float64) - second.outcomes
        interval = bootstrap_interval(difference)
        test = mcnemar(first.outcomes, second.outcomes)
        return cls(
            first.condition, second.condition, float(difference.mean()), interval.low,
            interval.high, test.only_first, test.only_second, test.p_value,
        )  # fmt: skip


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


def compare(
    rooms: Iterable[Room] | str | Path,
    tables: RoomTables,
    conditions: Sequence[tuple[str, str]],
    weights: str | None = None,
) -> Comparison:
    """Evaluate each (rule, source) on the same rooms.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    StoreError
        The tables hold no such source.
    """
    held = list(read_room_lines(Path(rooms)) if isinstance(rooms, str | Path) else rooms)
    return Comparison(
        tuple(evaluate(held, tables.deciding(rule=r, source=s), weights) for r, s in conditions)
    )


PRIOR_WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
EVIDENCE_POWERS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)


@dataclass(frozen=True)
class SweepPoint:
    """One setting and how it did; ``k`` is ``None`` where all of a room's objects count."""

    reduction: str
    source: str
    rule: str
    k: int | None
    prior_weight: float | None
    evidence_power: float | None
    rooms: int
    correct: int
    accuracy: float


@dataclass(frozen=True)
class Sweep:
    """All points, and one sentence for each thing that could not be varied."""

    points: tuple[SweepPoint, ...]
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        return {"sweep": [asdict(point) for point in self.points], "notes": list(self.notes)}


def sweep(rooms: Iterable[Room] | str | Path, tables: RoomTables) -> Sweep:
    """Evaluate the rooms over the grid of settings, from the tables alone.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    """
    held = list(read_room_lines(Path(rooms)) if isinstance(rooms, str | Path) else rooms)
    model = QueryModel(tables.version.manifest, allowed=False)  # nor are its misses noted
    tables = RoomTables(tables.version, tables.lookup, model, tables.decision)
    swept = _Sweeping(held, tables)
    points: list[SweepPoint] = []
    notes: list[str] = []
    for source in tables.lookup.sources:
        points += swept.pooled(source)
        if len(tables.lookup.sources[source].keys):
            points += swept.queried(source)
        else:
            notes.append(
                f"rules {QUERY} and {CALIBRATED} with source {source}: the tables hold no "
                "combinations; run `roomtables build --combinations all`"
            )
    other, why = with_other_reduction(tables)
    if other is not None:
        points += _Sweeping(held, other).pooled(PROXY, grid=False)
    notes.append(why)
    notes.append(f"k above {tables.lookup.k}: run `roomtables build -k {tables.lookup.k + 1}`")
    return Sweep(tuple(points), tuple(notes))


class _Sweeping:
    """The rooms of a sweep, and their most informative objects by source."""

    def __init__(self, rooms: Sequence[Room], tables: RoomTables) -> None:
        self._rooms = rooms
        self._tables = tables

    def pooled(self, source: str, grid: bool = True) -> Iterator[SweepPoint]:
        """λ × γ over all objects (λ of a proxy only), then 1, 2, … k objects at the defaults."""
        decision = self._tables.decision
        weights = PRIOR_WEIGHTS if grid else (decision.prior_weight,)
        for weight in weights if source == PROXY else (0.0,):
            for power in EVIDENCE_POWERS if grid else (decision.evidence_power,):
                settings = {"prior_weight": weight, "evidence_power": power}
                tables = self._tables.deciding(rule=POOLED, source=source, **settings)
                yield self._point(evaluate(self._rooms, tables), tables, None)
        tables = self._tables.deciding(rule=POOLED, source=source)
        for k, rooms in self._selections(source):
            yield self._point(evaluate(rooms, tables), tables, k)

    def queried(self, source: str) -> Iterator[SweepPoint]:
        """Rule ``query`` over k, and rule ``calibrated`` over k and λ."""
        for k, rooms in self._selections(source):
            tables = self._tables.deciding(rule=QUERY, source=source)
            yield self._point(evaluate(rooms, tables), tables, k)
            for weight in PRIOR_WEIGHTS:
                tables = self._tables.deciding(rule=CALIBRATED, source=source, prior_weight=weight)
                yield self._point(evaluate(rooms, tables), tables, k)

    def _selections(self, source: str) -> Iterator[tuple[int, list[Room]]]:
        """The same rooms with no more than their k most informative objects, k = 1, 2, ….

        What a rule does with those alone is what it does for that k: the key of fewer objects is
        in the tables too.
        """
        tables = self._tables.deciding(rule=POOLED, source=source)
        picked = [p.objects for p in tables.classify_many([room.objects for room in self._rooms])]
        for k in range(1, self._tables.lookup.k + 1):
            yield (
                k,
                [
                    # A room of nothing known stays a room: it is unanswered, not left out.
                    Room(room.room_id, objects[:k] or room.objects, room.truth)
                    for room, objects in zip(self._rooms, picked, strict=True)
                ],
            )

    def _point(self, found: Evaluation, tables: RoomTables, k: int | None) -> SweepPoint:
        decision = tables.decision
        calibrates = decision.rule == CALIBRATED or (
            decision.rule == POOLED and decision.source == PROXY
        )
        return SweepPoint(
            tables.lookup.reduction,
            found.source,
            found.rule,
            k,
            decision.prior_weight if calibrates else None,
            decision.evidence_power if decision.rule == POOLED else None,
            found.rooms,
            found.correct,
            found.accuracy,
        )
