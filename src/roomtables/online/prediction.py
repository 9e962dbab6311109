"""What roomtables says of one room, or of many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from roomtables.online.decider import KnownObject, TableDecider
from roomtables.online.rules import log_softmax

TABLE = "table"
LM = "lm"
NONE = "none"


class Prediction:
    """The room that a rule chose, and why; what costs time is computed when asked for.

    Attributes
    ----------
    room : the label, or ``None`` where nothing can answer
    unknown_objects : names, as given, that nothing could make use of
    answered_by : ``table``, ``lm`` or ``none``
    """

    __slots__ = ("_compared", "_decider", "_known", "answered_by", "room", "unknown_objects")

    def __init__(
        self,
        decider: TableDecider,
        room: str | None,
        answered_by: str,
        known: Sequence[int | KnownObject],
        unknown_objects: tuple[str, ...] = (),
        compared: NDArray[np.floating[Any]] | None = None,
    ) -> None:
        self._decider = decider
        self.room = room
        self.answered_by = answered_by
        self._known = known
        self.unknown_objects = unknown_objects
        self._compared = compared

    @property
    def rule(self) -> str:
        """The rule that decided."""
        return self._decider.decision.rule

    @property
    def source(self) -> str:
        """Whose co-occurrence decided."""
        return self._decider.decision.source

    @property
    def known_objects(self) -> tuple[KnownObject, ...]:
        """All objects of the room that a rule can use, most informative first."""
        find = self._decider.known_object
        return tuple(find(known) if isinstance(known, int) else known for known in self._known)

    @property
    def objects(self) -> tuple[str, ...]:
        """The picked objects, most informative first: also their order in the sentence."""
        find = self._decider.known_object
        picked = self._known[: self._decider.k]
        return tuple((find(o) if isinstance(o, int) else o).label.label for o in picked)

    @property
    def compared(self) -> NDArray[np.float64] | None:
        """What the rule compared, ``[candidates]`` in nats; ``None`` if unanswered."""
        if self.room is None:
            return None
        if self._compared is None:
            ranks = [known for known in self._known if isinstance(known, int)]
            self._compared = self._decider.compare(ranks)
        return np.asarray(self._compared, np.float64)

    @property
    def probabilities(self) -> dict[str, float]:
        """Softmax over the candidate rooms of what the rule compares; empty if unanswered."""
        compared = self.compared
        if compared is None:
            return {}
        values = np.exp(log_softmax(compared)).tolist()
        return dict(zip(self._decider.room_names, values, strict=True))

    @property
    def probability(self) -> float | None:
        """The probability of ``room``; ``None`` if unanswered."""
        return None if self.room is None else self.probabilities[self.room]

    def top(self, n: int) -> list[tuple[str, float]]:
        """The ``n`` most probable rooms, best first."""
        return sorted(self.probabilities.items(), key=lambda item: (-item[1], item[0]))[:n]

    def as_json(self, room_id: str | None = None) -> dict[str, Any]:
        """The prediction under the contract's keys."""
        probabilities = self.probabilities
        return {
            "room_id": room_id,
            "room": self.room,
            "probability": None if self.room is None else probabilities[self.room],
            "probabilities": probabilities,
            "objects": list(self.objects),
            "unknown_objects": list(self.unknown_objects),
            "rule": self.rule,
            "source": self.source,
            "answered_by": self.answered_by,
        }

    def __repr__(self) -> str:
        return f"Prediction(room={self.room!r}, objects={self.objects!r}, rule={self.rule!r})"


class Predictions(Sequence[Prediction]):
    """The predictions of many rooms, in order; each is made when it is looked at."""

    def __init__(self, rooms: Sequence[str | None], predict: Callable[[int], Prediction]) -> None:
        self._rooms = rooms
        self._predict = predict

    @property
    def rooms(self) -> list[str | None]:
        """The label of each room, ``None`` where nothing can answer."""
        return list(self._rooms)

    def __len__(self) -> int:
        return len(self._rooms)

    @overload
    def __getitem__(self, at: int) -> Prediction: ...
    @overload
    def __getitem__(self, at: slice) -> list[Prediction]: ...
    def __getitem__(self, at: int | slice) -> Prediction | list[Prediction]:
        places = range(len(self._rooms))[at]
        if isinstance(places, range):
            return [self._predict(place) for place in places]
        return self._predict(places)

    def __iter__(self) -> Iterator[Prediction]:
        return map(self._predict, range(len(self._rooms)))
