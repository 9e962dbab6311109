"""How often the answer is right, on rooms whose label is known."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import InputError
from roomtables.evaluation import statistics
from roomtables.evaluation.grouping import in_one_group
from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables, classify_rooms
from roomtables.online.prediction import NONE, Prediction
from roomtables.rooms import Room, read_room_lines

NO_TRUTH = "no true label"
NOT_A_CANDIDATE = "true label is not a candidate"
NO_OBJECTS = "no objects"
# Why an evaluated room has no answer.
NOT_HELD = "no table holds its combination"
NOTHING_KNOWN = "no known object"
TOO_UNSURE = "the answer is too unsure"
TOP = 3


@dataclass(frozen=True)
class Judged:
    """One evaluated room: its true labels among the candidates, and what was predicted."""

    room: Room
    truth: tuple[str, ...]
    prediction: Prediction

    @property
    def correct(self) -> bool:
        """Right if the answer is any of the true labels; unanswered is wrong."""
        return self.prediction.room in self.truth

    @property
    def in_top(self) -> bool:
        """Whether the three best candidates hold a true label; unanswered is wrong."""
        best = self.prediction.best(TOP) if self.prediction.room is not None else ()
        return any(room in self.truth for room in best)

    def in_group(self, groups: Mapping[str, str]) -> bool:
        """Right if the answer is of one group with any of the true labels; unanswered is wrong."""
        answer = self.prediction.room
        return answer is not None and any(
            in_one_group(groups, answer, truth) for truth in self.truth
        )

    @property
    def why_unanswered(self) -> str | None:
        """Why the room has no answer; ``None`` where it has one."""
        found = self.prediction
        if found.room is not None:
            return None
        if found.answered_by != NONE:
            return TOO_UNSURE
        return NOT_HELD if found.objects else NOTHING_KNOWN


@dataclass(frozen=True)
class Evaluation:
    """Accuracy of one rule and source on a list of rooms.

    ``groups`` maps the rooms that people use for one another to a group; ``None`` where no groups
    were asked for.
    """

    rule: str
    source: str
    candidates: tuple[str, ...]
    judged: tuple[Judged, ...]
    skipped: Counter[str]
    groups: Mapping[str, str] | None = None

    @property
    def rooms(self) -> int:
        """How many rooms were evaluated."""
        return len(self.judged)

    @property
    def correct(self) -> int:
        """How many rooms were labelled right."""
        return sum(judged.correct for judged in self.judged)

    @property
    def accuracy(self) -> float:
        """Share of rooms labelled right."""
        return self.correct / self.rooms

    @property
    def macro_accuracy(self) -> float:
        """Mean over room labels of the share labelled right: each label counts the same."""
        per_room = self.per_room()
        return float(sum(row["accuracy"] for row in per_room.values()) / len(per_room))

    @property
    def unanswered(self) -> Counter[str]:
        """How many rooms have no answer, by the reason; they count as wrong."""
        return Counter(why for judged in self.judged if (why := judged.why_unanswered))

    @property
    def backed_off(self) -> int:
        """How many rooms rule ``pooled`` decided, as nothing could answer by the rule asked for."""
        return sum(judged.prediction.backed_off for judged in self.judged)

    def per_room(self) -> dict[str, dict[str, Any]]:
        """Counts of rooms and the accuracy per true label; a room counts under its first label."""
        by_label: dict[str, list[Judged]] = defaultdict(list)
        for judged in self.judged:
            by_label[judged.truth[0]].append(judged)
        return {label: _counted(by_label[label]) for label in sorted(by_label)}

    def confusion(self) -> list[dict[str, Any]]:
        """How many rooms of each true label got each answer (``None``: unanswered)."""
        counts = Counter((judged.truth[0], judged.prediction.room) for judged in self.judged)
        ordered = sorted(counts.items(), key=lambda item: (item[0][0], item[0][1] or ""))
        return [{"room": t, "predicted": p, "rooms": n} for (t, p), n in ordered]

    def baselines(self) -> dict[str, float]:
        """Accuracy of a uniform guess, and of always answering the most frequent true label."""
        commonest = max(row["rooms"] for row in self.per_room().values())
        return {"uniform": 1 / len(self.candidates), "majority": commonest / self.rooms}

    @property
    def condition(self) -> str:
        """``rule:source``."""
        return f"{self.rule}:{self.source}"

    @property
    def outcomes(self) -> NDArray[np.bool_]:
        """Right or wrong, one per evaluated room."""
        return np.array([judged.correct for judged in self.judged])

    def reliability(self) -> list[statistics.Bin]:
        """The share of right answers, binned by the probability they were given with."""
        return statistics.reliability(*self._answered())

    def risk_coverage(self) -> list[statistics.Operating]:
        """Coverage and accuracy where only answers of at least some probability are given."""
        return statistics.risk_coverage(*self._answered(), rooms=self.rooms)

    def _answered(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Probability and outcome of the rooms that were answered."""
        answered = [judged for judged in self.judged if judged.prediction.room is not None]
        probabilities = [judged.prediction.probability or 0.0 for judged in answered]
        return np.array(probabilities), np.array([judged.correct for judged in answered], bool)

    @property
    def top_3_accuracy(self) -> float:
        """Share of rooms with a true label among the three best candidates."""
        return sum(judged.in_top for judged in self.judged) / self.rooms

    @property
    def grouped_accuracy(self) -> float | None:
        """Share of rooms whose answer is of a true label's group; ``None`` without groups."""
        if self.groups is None:
            return None
        return sum(judged.in_group(self.groups) for judged in self.judged) / self.rooms

    def statistics(self) -> dict[str, Any]:
        """Confidence interval, top-3 accuracy, calibration, and risk against coverage."""
        bins, points = self.reliability(), self.risk_coverage()
        return {
            "accuracy_interval": statistics.bootstrap_interval(self.outcomes).as_json(),
            "top_3_accuracy": self.top_3_accuracy,
            "expected_calibration_error": statistics.expected_calibration_error(bins),
            "reliability": statistics.as_records(bins),
            "area_under_risk_coverage": statistics.area_under_risk(points),
            "risk_coverage": statistics.as_records(points),
        }

    def as_json(self, *, statistics: bool = False) -> dict[str, Any]:
        """The evaluation under the contract's keys; on request with its ``statistics``."""
        extra = {"statistics": self.statistics()} if statistics else {}
        grouped = {} if self.groups is None else {"grouped_accuracy": self.grouped_accuracy}
        return {
            "rooms": self.rooms,
            "correct": self.correct,
            "accuracy": self.accuracy,
            "macro_accuracy": self.macro_accuracy,
            "rule": self.rule,
            "source": self.source,
            "per_room": self.per_room(),
            "confusion": self.confusion(),
            "baselines": self.baselines(),
            "answered_by": dict(Counter(j.prediction.answered_by for j in self.judged)),
            "backed_off": self.backed_off,
            "unanswered": self.unanswered.total(),
            "top_3_accuracy": self.top_3_accuracy,
            **grouped,
            "skipped": dict(self.skipped),
            **extra,
        }


def _counted(judged: Sequence[Judged]) -> dict[str, Any]:
    """How rooms of one true label did."""
    correct = sum(room.correct for room in judged)
    return {
        "rooms": len(judged),
        "correct": correct,
        "accuracy": correct / len(judged),
        "unanswered": sum(room.prediction.room is None for room in judged),
        "backed_off": sum(room.prediction.backed_off for room in judged),
    }


def evaluate(
    rooms: Iterable[Room] | str | Path,
    tables: RoomTables,
    weights: str | None = None,
    groups: Mapping[str, str] | None = None,
) -> Evaluation:
    """Label rooms and compare with their true labels.

    ``weights`` (``counts`` or ``confidences``) is as for
    :func:`~roomtables.online.weighing.classify_rooms`; ``groups`` maps rooms that people use for
    one another to a group, as :func:`~roomtables.evaluation.grouping.read_groups` reads them.

    Left out and counted: rooms without a true label, without objects, and those none of whose true
    labels is a candidate.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    """
    candidates = tuple(room.label for room in tables.candidates)
    skipped: Counter[str] = Counter()
    kept: list[tuple[Room, tuple[str, ...]]] = []
    for room in room_list(rooms):
        truth, why = _truth(room, tables, candidates)
        if why:
            skipped[why] += 1
        else:
            kept.append((room, truth))
    if not kept:
        reasons = ", ".join(f"{why}: {n}" for why, n in skipped.items()) or "the list is empty"
        raise InputError(f"no room to evaluate ({reasons}); check `room` and `--labels`")
    predictions = classify_rooms(tables, [room for room, _ in kept], weights)
    judged = tuple(
        Judged(room, truth, prediction)
        for (room, truth), prediction in zip(kept, predictions, strict=True)
    )
    decision = tables.decision
    return Evaluation(decision.rule, decision.source, candidates, judged, skipped, groups)


def room_list(rooms: Iterable[Room] | str | Path) -> list[Room]:
    """Rooms as a list: those of a file of room lines, or those given.

    Raises
    ------
    InputError
        The file cannot be read or is malformed.
    """
    return list(read_room_lines(Path(rooms)) if isinstance(rooms, str | Path) else rooms)


def _truth(
    room: Room, tables: RoomTables, candidates: tuple[str, ...]
) -> tuple[tuple[str, ...], str | None]:
    """The room's true labels among the candidates, and why it is left out, if it is."""
    names = [normalise(label) for label in room.truth]
    labels = [tables.lookup.room_aliases.get(name, name) for name in names]
    truth = tuple(dict.fromkeys(label for label in labels if label in candidates))
    if not room.truth:
        return truth, NO_TRUTH
    if not truth:
        return truth, NOT_A_CANDIDATE
    return truth, None if room.objects else NO_OBJECTS
