"""The same rooms under several conditions (rule and source), tested pair by pair for a difference
by more than chance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from roomtables.errors import InputError
from roomtables.evaluation.judging import Evaluation, evaluate, room_list
from roomtables.evaluation.statistics import bootstrap_interval, mcnemar
from roomtables.online.classifier import RoomTables
from roomtables.rooms import Room
from roomtables.schemas import RULES, SOURCES


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
    groups: Mapping[str, str] | None = None,
) -> Comparison:
    """Evaluate each (rule, source) on the same rooms; the rest is as for :func:`evaluate`.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    StoreError
        The tables hold no such source.
    """
    held = room_list(rooms)
    return Comparison(
        tuple(
            evaluate(held, tables.deciding(rule=rule, source=source), weights, groups)
            for rule, source in conditions
        )
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
