"""Rooms under a grid of settings (k, λ, γ, rule, source), decided from the tables alone.

A setting is judged only where the tables hold what it needs: a k whose combinations they lack is
not varied, and a note says so, as rooms without an answer would count as wrong.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from roomtables.evaluation.judging import NOT_HELD, Evaluation, evaluate, room_list
from roomtables.online.classifier import RoomTables
from roomtables.online.model import QueryModel
from roomtables.online.rules import effective_prior_weight
from roomtables.rooms import Room
from roomtables.schemas import CALIBRATED, POOLED, QUERY, REDUCTIONS

PRIOR_WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""Values of λ that a sweep tries."""
EVIDENCE_POWERS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
"""Values of γ that a sweep tries."""


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
    points: list[SweepPoint] = []
    gaps: list[Gap] = []
    for source in tables.lookup.sources:
        pooled = tables.deciding(rule=POOLED, source=source)
        by_k = _with_fewer_objects(held, pooled)
        points += _over_weights(held, pooled)
        points += [_point(evaluate(fewer, pooled), pooled, k) for k, fewer in by_k.items()]
        for k, fewer in by_k.items():
            queried = tables.deciding(rule=QUERY, source=source)
            found = evaluate(fewer, queried)
            if lacking := found.unanswered[NOT_HELD]:
                gaps.append(Gap(source, k, lacking, found.rooms))
            else:
                points.append(_point(found, queried, k))
                points += _over_prior_weights(fewer, queried, k)
    return Sweep(tuple(points), tuple(gaps), tables.lookup.k, tables.lookup.reduction)


@dataclass(frozen=True)
class Gap:
    """A k that rules ``query`` and ``calibrated`` cannot be judged at, for want of query sentences.

    ``lacking`` of the ``rooms`` evaluated have a combination of k objects that no table holds.
    """

    source: str
    k: int
    lacking: int
    rooms: int


@dataclass(frozen=True)
class Sweep:
    """All points, the k that could not be judged, and the tables' own k and reduction."""

    points: tuple[SweepPoint, ...]
    gaps: tuple[Gap, ...]
    k: int
    reduction: str

    @property
    def not_held(self) -> list[str]:
        """For each source, which k were not varied as the tables lack combinations."""
        return [
            f"rules {QUERY} and {CALIBRATED}, source {source}: the tables lack the combinations of "
            + ", ".join(
                f"{gap.lacking} of {gap.rooms} rooms at k = {gap.k}"
                for gap in self.gaps
                if gap.source == source
            )
            for source in dict.fromkeys(gap.source for gap in self.gaps)
        ]

    @property
    def notes(self) -> list[str]:
        """One sentence for each thing that could not be varied, with the command that helps."""
        other = next(name for name in REDUCTIONS if name != self.reduction)
        cure = "run `roomtables build --combinations all`, or `-k K --combinations ROOMS` for one k"
        return [
            *(f"{line}; {cure}" for line in self.not_held),
            f"reduction {other}: run `roomtables build --reduction {other}`",
            f"k above {self.k}: run `roomtables build -k {self.k + 1}`",
        ]

    def as_json(self) -> dict[str, Any]:
        """``{"sweep": [point, …], "not_held": [gap, …], "notes": [sentence, …]}``."""
        return {
            "sweep": [asdict(point) for point in self.points],
            "not_held": [asdict(gap) for gap in self.gaps],
            "notes": self.notes,
        }


@dataclass(frozen=True)
class SweepPoint:
    """One setting, and how many of the rooms it labels right.

    ``k`` is ``None`` where all of a room's objects count; ``prior_weight`` (λ) and
    ``evidence_power`` (γ) are ``None`` where they have no effect. ``unanswered`` rooms (no known
    object, or an answer too unsure) count as wrong; none is backed off.
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
    unanswered: int


def _over_weights(rooms: Sequence[Room], pooled: RoomTables) -> Iterator[SweepPoint]:
    """Rule ``pooled`` on all the rooms' objects: each λ that makes a difference, with each γ."""
    source = pooled.decision.source
    weights = dict.fromkeys(effective_prior_weight(source, weight) for weight in PRIOR_WEIGHTS)
    for weight, power in product(weights, EVIDENCE_POWERS):
        tables = pooled.deciding(prior_weight=weight, evidence_power=power)
        yield _point(evaluate(rooms, tables), tables, None)


def _over_prior_weights(rooms: Sequence[Room], queried: RoomTables, k: int) -> Iterator[SweepPoint]:
    """Rule ``calibrated`` with each λ."""
    for weight in PRIOR_WEIGHTS:
        tables = queried.deciding(rule=CALIBRATED, prior_weight=weight)
        yield _point(evaluate(rooms, tables), tables, k)


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


def _point(found: Evaluation, tables: RoomTables, k: int | None) -> SweepPoint:
    """The point of an evaluation under the decision of ``tables``."""
    decision = tables.decision
    pools = decision.rule == POOLED
    calibrates = decision.rule == CALIBRATED or (
        pools and effective_prior_weight(decision.source, 1.0) > 0
    )
    return SweepPoint(
        reduction=tables.lookup.reduction,
        source=found.source,
        rule=found.rule,
        k=k,
        prior_weight=decision.prior_weight if calibrates else None,
        evidence_power=decision.evidence_power if pools else None,
        rooms=found.rooms,
        correct=found.correct,
        accuracy=found.accuracy,
        unanswered=found.unanswered.total(),
    )
