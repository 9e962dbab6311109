"""The paper's conditions on rooms of one's own, with the paper's published numbers beside.

Published: Chen, Hu, Talak, Carlone, tables 1 and 2: GPT-J in half precision, all 1,878 rooms of
Matterport3D, k = 3.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from roomtables.evaluation.judging import Evaluation, evaluate
from roomtables.evaluation.statistics import bootstrap_interval
from roomtables.online.classifier import RoomTables
from roomtables.rooms import Room
from roomtables.schemas import GROUND_TRUTH, POOLED, PROXY, QUERY

PUBLISHED_ROOMS = {
    "bar": 3, "bathroom": 365, "bedroom": 251, "classroom": 2, "closet": 99,
    "conference room": 16, "dining room": 74, "family room": 61, "game room": 17, "garage": 14,
    "gym": 16, "hallway": 326, "kitchen": 78, "laundry room": 35, "library": 1, "living room": 71,
    "lobby": 62, "lounge": 64, "office": 98, "spa": 44, "staircase": 152, "television room": 13,
    "utility room": 16,
}  # fmt: skip
PUBLISHED_ACCURACY = {
    ("nyuclass", GROUND_TRUTH): 0.5241,
    ("mpcat40", GROUND_TRUTH): 0.4936,
    ("nyuclass", PROXY): 0.2814,
    ("mpcat40", PROXY): 0.2700,
}
CONDITIONS = ((QUERY, GROUND_TRUTH), (QUERY, PROXY), (POOLED, GROUND_TRUTH), (POOLED, PROXY))


@dataclass(frozen=True)
class Trial:
    """A condition of table 2, and its evaluation, ``None`` where the tables cannot answer."""

    labels: str
    rule: str
    source: str
    evaluation: Evaluation | None

    @property
    def published(self) -> float | None:
        """The paper's accuracy in this condition; it has none for other rules."""
        return PUBLISHED_ACCURACY.get((self.labels, self.source)) if self.rule == QUERY else None

    def as_json(self) -> dict[str, Any]:
        """A row of table 2; its numbers are ``None`` where the tables cannot answer."""
        found = self.evaluation
        row = {"labels": self.labels, "source": self.source, "rule": self.rule,
               "published": self.published}  # fmt: skip
        if found is None:
            nothing = ("rooms", "correct", "unanswered", "accuracy", "interval")
            return row | dict.fromkeys(nothing)
        interval = bootstrap_interval(found.outcomes)
        return row | {
            "rooms": found.rooms,
            "correct": found.correct,
            "unanswered": found.unanswered.total(),
            "accuracy": found.accuracy,
            "interval": [interval.low, interval.high],
        }


@dataclass(frozen=True)
class Reproduction:
    """What the paper's tables 1 and 2 and its per-room figure are made from.

    ``frequencies`` counts, by label space, the rooms of each true label.
    """

    frequencies: dict[str, Counter[str]]
    trials: tuple[Trial, ...]

    def table_1(self) -> list[dict[str, Any]]:
        """Room label frequencies: the paper's, then those of each list of rooms."""
        total = sum(PUBLISHED_ROOMS.values())
        rooms = sorted(
            {*PUBLISHED_ROOMS, *(r for found in self.frequencies.values() for r in found)}
        )
        rows: list[dict[str, Any]] = []
        for room in rooms:
            published = PUBLISHED_ROOMS.get(room, 0)
            row = {"room": room, "paper": published, "paper share": published / total}
            for labels, found in self.frequencies.items():
                row |= {labels: found[room], f"{labels} share": found[room] / found.total()}
            rows.append(row)
        return rows

    def table_2(self) -> list[dict[str, Any]]:
        """Accuracy per condition, the published number beside ours."""
        return [trial.as_json() for trial in self.trials]

    def as_json(self) -> dict[str, Any]:
        """Both tables, as lists of rows."""
        return {"table_1": self.table_1(), "table_2": self.table_2()}


def reproduce(columns: Sequence[tuple[RoomTables, Iterable[Room]]]) -> Reproduction:
    """Evaluate every condition that the tables can answer, one column per label space.

    Raises
    ------
    InputError
        No room is left to evaluate.
    """
    frequencies: dict[str, Counter[str]] = {}
    trials: list[Trial] = []
    for tables, rooms in columns:
        held = list(rooms)
        labels = tables.version.manifest.labels
        for rule, source in CONDITIONS:
            if source not in tables.lookup.sources:
                trials.append(Trial(labels, rule, source, None))
                continue
            alone = tables.deciding(rule=rule, source=source, backoff=False)
            found = evaluate(held, alone)
            answered = any(judged.prediction.room is not None for judged in found.judged)
            trials.append(Trial(labels, rule, source, found if answered else None))
            frequencies[labels] = Counter(judged.truth[0] for judged in found.judged)
    return Reproduction(frequencies, tuple(trials))
