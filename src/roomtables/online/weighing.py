"""Weigh objects by how many there are of a kind, or by how surely they were detected.

Both multiply the weight w(o) of rule ``pooled``: a detection by its confidence, n objects of a kind
by 1 + ln n (sublinear term weighting: ten chairs say more than one, but not ten times as much).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence

from roomtables.errors import ConfigError
from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.rooms import COUNTS, Room
from roomtables.schemas import POOLED


def classify_rooms(
    tables: RoomTables, rooms: Sequence[Room], weights: str | None = None
) -> Sequence[Prediction]:
    """Label rooms, in order; ``weights`` is ``counts``, ``confidences``, or ``None`` for neither.

    With counts, an object named twice counts twice; of several confidences the highest counts. A
    room without these numbers has one of each object, surely detected.

    Raises
    ------
    ConfigError
        There are weights, and the rule is not ``pooled``.
    InputError
        A room's counts or confidences are malformed.
    """
    if weights is None:
        return tables.classify_many([room.objects for room in rooms])
    if tables.decision.rule != POOLED:
        raise ConfigError(
            f"weights act on rule {POOLED}, not {tables.decision.rule}; add `--rule {POOLED}`"
        )
    factors = [_factors(room, weights, tables.lookup.object_aliases) for room in rooms]
    predictions = tables.classify_many([room.objects for room in rooms])
    return [
        prediction.weighed(of_room).unless_unsure()
        for prediction, of_room in zip(predictions, factors, strict=True)
    ]


def _factors(room: Room, weights: str, aliases: Mapping[str, str]) -> dict[str, float]:
    """The factor of each object's weight, by label."""
    measured: dict[str, list[float]] = defaultdict(list)
    for name, value in zip(room.objects, room.measured(weights), strict=True):
        spelled = normalise(name)
        measured[aliases.get(spelled, spelled)].append(value)
    if weights == COUNTS:
        return {label: _of_count(sum(values)) for label, values in measured.items()}
    return {label: max(values) for label, values in measured.items()}


def _of_count(n: float) -> float:
    """1 + ln n from one object on; a fraction of an object is that fraction."""
    return 1 + math.log(n) if n >= 1 else n
