"""Statistics of right and wrong answers: confidence intervals, paired tests, calibration, risk.

Functions take arrays with one entry per room: booleans that say whether the answer was right, and
probabilities from 0 to 1.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 2000
SEED = 0
LEVEL = 0.95
BINS = 10


@dataclass(frozen=True)
class Interval:
    """A percentile bootstrap interval of a mean: from ``low`` to ``high`` at a confidence level."""

    low: float
    high: float
    level: float = LEVEL
    resamples: int = RESAMPLES
    seed: int = SEED

    def as_json(self) -> dict[str, float]:
        """The fields under their names."""
        return asdict(self)


def bootstrap_interval(
    values: ArrayLike, *, level: float = LEVEL, resamples: int = RESAMPLES, seed: int = SEED
) -> Interval:
    """The interval of the mean of ``values`` (one per room); rooms are drawn with replacement.

    For the difference of two rules pass the difference of their outcomes, room by room: the rooms
    are then drawn in pairs. The same seed gives the same interval.

    Raises
    ------
    ValueError
        ``values`` is empty.
    """
    values = np.asarray(values, np.float64)
    if not len(values):
        raise ValueError("no value to resample")
    rng = np.random.default_rng(seed)
    means = [values[rng.integers(0, len(values), len(values))].mean() for _ in range(resamples)]
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high), level, resamples, seed)


@dataclass(frozen=True)
class McNemar:
    """The exact McNemar test of two rules on the same rooms.

    Attributes
    ----------
    only_first, only_second : how many rooms only that rule got right
    p_value : two-sided: were both rules as good, how often chance would split the rooms on which
        they differ at least as unevenly
    """

    only_first: int
    only_second: int
    p_value: float


def mcnemar(first: ArrayLike, second: ArrayLike) -> McNemar:
    """Compare two rules by the rooms that only one of them got right (booleans, one per room)."""
    a, b = np.asarray(first, bool), np.asarray(second, bool)
    only_first, only_second = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    differing = only_first + only_second
    # Whole numbers divide exactly, where a float would overflow beyond a thousand rooms.
    ways = tail = 1  # of choosing 0 of the differing rooms, then of at most n
    for n in range(min(only_first, only_second)):
        ways = ways * (differing - n) // (n + 1)
        tail += ways
    return McNemar(only_first, only_second, min(1.0, 2 * tail / 2**differing))


@dataclass(frozen=True)
class Bin:
    """Rooms whose probability lies in (``low``, ``high``]: how sure, and how often right."""

    low: float
    high: float
    rooms: int
    mean_probability: float
    accuracy: float


def reliability(probability: ArrayLike, correct: ArrayLike, bins: int = BINS) -> list[Bin]:
    """The reliability diagram: rooms binned by their answer's probability, without empty bins."""
    p, right = np.asarray(probability, np.float64), np.asarray(correct, np.float64)
    # In (low, high]: a probability of exactly 0.1 is in the first bin of ten.
    index = np.clip(np.ceil(p * bins).astype(int) - 1, 0, bins - 1)
    found = []
    for number in np.unique(index):
        here = index == number
        edges = float(number) / bins, float(number + 1) / bins
        found.append(Bin(*edges, int(here.sum()), float(p[here].mean()), float(right[here].mean())))
    return found


def expected_calibration_error(bins: list[Bin]) -> float:
    """Mean over rooms of |accuracy − mean probability| of their bin; 0 is perfectly calibrated."""
    rooms = sum(b.rooms for b in bins)
    return sum(b.rooms * abs(b.accuracy - b.mean_probability) for b in bins) / max(rooms, 1)


@dataclass(frozen=True)
class Operating:
    """Answering only at or above a probability: the share answered, and the share right of it."""

    min_probability: float
    coverage: float
    accuracy: float


def risk_coverage(
    probability: ArrayLike, correct: ArrayLike, rooms: int | None = None
) -> list[Operating]:
    """Coverage and accuracy at every threshold on the probability, the highest first.

    Rooms of equal probability come in together, as no threshold parts them. ``rooms`` is how many
    rooms the coverage is a share of, where some were left unanswered and are not given here.
    """
    p, right = np.asarray(probability, np.float64), np.asarray(correct, np.float64)
    asked = len(p) if rooms is None else rooms
    order = np.argsort(-p, kind="stable")
    p, right = p[order], np.cumsum(right[order])
    last = np.flatnonzero(np.append(p[1:] != p[:-1], True)) if len(p) else ()
    return [
        Operating(float(p[n]), (int(n) + 1) / asked, float(right[n]) / (int(n) + 1)) for n in last
    ]


def area_under_risk(points: list[Operating]) -> float:
    """The mean share wrong over the coverages reached, from 0 (best) to 1; 0 where none is."""
    area, before = 0.0, 0.0
    for point in points:
        area += (point.coverage - before) * (1 - point.accuracy)
        before = point.coverage
    return area / before if before else 0.0


def as_records(rows: list[Any]) -> list[dict[str, Any]]:
    """Dataclasses as dictionaries."""
    return [asdict(row) for row in rows]
