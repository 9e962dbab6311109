"""How to decide, and which rooms may be the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from roomtables.config import check_decision
from roomtables.errors import ConfigError, InputError
from roomtables.labels import RoomLabel, normalise
from roomtables.online import rules
from roomtables.online.model import QueryModel
from roomtables.schemas import PROXY, RULES
from roomtables.storage.lookup import Lookup

AUTO: Literal["auto"] = "auto"


@dataclass(frozen=True)
class Decision:
    """How to decide.

    Attributes
    ----------
    rule : ``query``, ``calibrated`` or ``pooled``
    source : whose co-occurrence ranks the objects: ``proxy`` or ``ground_truth``
    prior_weight : λ, how much of the model's bias towards rooms is taken away
    evidence_power : γ, how steeply informative objects count for more under rule ``pooled``
    rooms : names of the candidate rooms, or the name of one; none: all predicted rooms
    temperature : divides what the rule compares before it becomes probabilities; ``auto`` is the
        sum of the objects' weights under rule ``pooled``, and 1 under the others
    min_probability : a room whose answer is less probable gets none
    backoff : whether rule ``pooled`` decides where the tables lack what another rule needs, and
        there is no model to ask

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
    backoff: bool = True

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ConfigError(f"no rule {self.rule!r}; use one of {', '.join(RULES)}")
        check_decision(self.prior_weight, self.evidence_power)
        if self.temperature != AUTO and not 0 < self.temperature < float("inf"):
            raise ConfigError(f"temperature must be above 0 or `auto`, not {self.temperature}")
        if not 0 <= self.min_probability <= 1:
            raise ConfigError(f"min probability must be from 0 to 1, not {self.min_probability}")
        rooms = (self.rooms,) if isinstance(self.rooms, str) else tuple(self.rooms)
        if not all(isinstance(name, str) for name in rooms):
            raise ConfigError(f"rooms must be names, not {rooms!r}"[:200])
        object.__setattr__(self, "rooms", rooms)


@dataclass(frozen=True)
class Candidates:
    """The candidate rooms, sorted by label, and what the tables or the model say of them.

    Attributes
    ----------
    rooms : the rooms
    names : their labels
    in_tables : whether the query scores have a column for each of them
    columns : which columns these are; ``None`` for all columns, or if not in tables
    room_logits : ``[objects, candidates]``, nats, as
        :class:`~roomtables.storage.lookup.SourceArrays` has them
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
        """All predicted rooms, or those named; the model is asked about rooms that no table knows.

        Raises
        ------
        InputError
            A name is empty, names a room that is never predicted, or names one that no table
            knows and no model may be asked about.
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
        all_columns = len(columns) == len(predicted)
        return cls(
            rooms, labels, True, None if all_columns else columns, room_logits, arrays.bias[columns]
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
    if unpredicted:
        raise InputError(
            f"room {unpredicted[0]!r} is never predicted in label space "
            f"{model.labels}; leave it out of `--rooms`"
        )
    usable = source == PROXY and model.extends_tables
    scores = model.score_singles(lookup.objects, rooms, lookup.rooms) if usable else None
    if scores is None:
        raise InputError(
            f"no table knows room {unlisted[0]!r}, and there is no model to ask; add it to "
            "rooms.csv and run `roomtables build`, or leave it out of `--rooms`"
        )
    return np.stack(scores)
