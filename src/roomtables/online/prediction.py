"""What roomtables says of one room."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.online.rules import log_softmax

TABLE = "table"
LM = "lm"
NONE = "none"


class Prediction:
    """The room that a rule chose, and why; probabilities are computed when asked for.

    Attributes
    ----------
    room : the label, or ``None`` where nothing can answer
    objects : the picked objects, most informative first: also their order in the sentence
    unknown_objects : names, as given, that nothing could make use of
    rule, source : what decided, and whose co-occurrence
    answered_by : ``table``, ``lm`` or ``none``
    """

    __slots__ = (
        "_compared", "_rooms", "answered_by", "objects", "room", "rule", "source",
        "unknown_objects",
    )  # fmt: skip

    def __init__(
        self,
        rooms: tuple[str, ...],
        compared: NDArray[np.floating[Any]] | None,
        objects: tuple[str, ...],
        unknown_objects: tuple[str, ...],
        rule: str,
        source: str,
        answered_by: str,
    ) -> None:
        self._rooms = rooms
        self._compared = compared
        # Rooms are sorted and argmax takes the first: a tie goes to the label that sorts first.
        self.room = None if compared is None else rooms[int(compared.argmax())]
        self.objects = objects
        self.unknown_objects = unknown_objects
        self.rule = rule
        self.source = source
        self.answered_by = answered_by

    @property
    def probabilities(self) -> dict[str, float]:
        """Softmax over the candidate rooms of what the rule compares; empty if unanswered."""
        if self._compared is None:
            return {}
        values = np.exp(log_softmax(np.asarray(self._compared, np.float64)))
        return dict(zip(self._rooms, values.tolist(), strict=True))

    @property
    def probability(self) -> float | None:
        """The probability of ``room``; ``None`` if unanswered."""
        return None if self.room is None else self.probabilities[self.room]

    def top(self, n: int) -> list[tuple[str, float]]:
        """The ``n`` most probable rooms, best first."""
        return sorted(self.probabilities.items(), key=lambda item: (-item[1], item[0]))[:n]

    def as_json(self, room_id: str | None = None) -> dict[str, Any]:
        """The prediction under the contract's keys."""
        return {
            "room_id": room_id,
            "room": self.room,
            "probability": self.probability,
            "probabilities": self.probabilities,
            "objects": list(self.objects),
            "unknown_objects": list(self.unknown_objects),
            "rule": self.rule,
            "source": self.source,
            "answered_by": self.answered_by,
        }

    def __repr__(self) -> str:
        return f"Prediction(room={self.room!r}, objects={self.objects!r}, rule={self.rule!r})"
