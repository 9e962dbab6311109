"""The rooms that may be the answer, and what every object says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import InputError
from roomtables.labels import RoomLabel, normalise
from roomtables.online import rules
from roomtables.online.model import QueryModel
from roomtables.schemas import PROXY
from roomtables.twin import Twin


@dataclass(frozen=True)
class Candidates:
    """The candidate rooms, sorted by label.

    Attributes
    ----------
    rooms : the rooms
    names : their labels
    in_tables : whether the tables hold scores of all of them
    columns : their columns of the query scores; ``None`` for all columns, or if not in tables
    object_room : ``[objects, candidates]``, nats, as :class:`~roomtables.twin.SourceArrays`
    bias : ``[candidates]``, b in nats
    """

    rooms: tuple[RoomLabel, ...]
    names: tuple[str, ...]
    in_tables: bool
    columns: NDArray[np.intp] | None
    object_room: NDArray[np.float64]
    bias: NDArray[np.float64]

    @classmethod
    def choose(cls, twin: Twin, source: str, names: Sequence[str], model: QueryModel) -> Candidates:
        """All predicted rooms, or those named; the model is asked about rooms in no table.

        Raises
        ------
        InputError
            A name is empty, names a room that is never predicted, or names one that no table
            knows where no model may be asked.
        """
        rooms = _chosen(twin, names)
        predicted = [number for number, room in enumerate(twin.rooms) if room.predicted]
        places = {twin.rooms[number].label: place for place, number in enumerate(predicted)}
        labels = tuple(room.label for room in rooms)
        if not all(label in places for label in labels):
            object_room = _ask_about_rooms(twin, source, rooms, model)
            return cls(rooms, labels, False, None, object_room, rules.room_bias(object_room))
        columns = np.array([places[label] for label in labels])
        arrays = twin.sources[source]
        object_room = np.ascontiguousarray(arrays.object_room[:, predicted][:, columns])
        everything = len(columns) == len(predicted)
        return cls(
            rooms, labels, True, None if everything else columns, object_room, arrays.bias[columns]
        )


def _chosen(twin: Twin, names: Sequence[str]) -> tuple[RoomLabel, ...]:
    if not names:
        return tuple(room for room in twin.rooms if room.predicted)
    by_label = {room.label: room for room in twin.rooms}
    chosen = {}
    for name in names:
        label = twin.room_aliases.get(normalise(name), normalise(name))
        if not label:
            raise InputError("an empty room name among `--rooms`; write `--rooms kitchen,office`")
        chosen[label] = by_label.get(label) or RoomLabel.named(label)
    return tuple(chosen[label] for label in sorted(chosen))


def _ask_about_rooms(
    twin: Twin, source: str, rooms: tuple[RoomLabel, ...], model: QueryModel
) -> NDArray[np.float64]:
    """S(o, r) for candidates of which some are in no table, ``[objects, candidates]``."""
    unlisted = [room.label for room in rooms if room not in twin.rooms]
    unpredicted = [room.label for room in rooms if not room.predicted]
    if unpredicted and not unlisted:
        raise InputError(
            f"room {unpredicted[0]!r} is never predicted in label space "
            f"{model.labels}; leave it out of `--rooms`"
        )
    usable = source == PROXY and model.extends_tables
    scores = model.score([([o], rooms) for o in twin.objects]) if usable else None
    if scores is None:
        raise InputError(
            f"no table knows room {unlisted[0]!r}, and there is no model to ask; add it to "
            "rooms.csv and run `roomtables build`, or leave it out of `--rooms`"
        )
    return np.stack(scores)
