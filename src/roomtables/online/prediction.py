"""What roomtables says of one room, or of many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from roomtables.online.decision import AUTO, KnownObject, TableDecider
from roomtables.online.rules import log_softmax

TABLE = "table"
LM = "lm"
NONE = "none"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one object says for the best room, and for the runner-up, in nats.

    Attributes
    ----------
    object : its label
    counted : whether the rule used it: rule ``query`` picks k objects, ``pooled`` takes all
    weight : w(o) = (log n − H′)^γ, how much it counts
    room, room_nats : the best room, and w(o) L′(o, room)
    runner_up, runner_up_nats : the second best; ``None`` where there is one candidate only
    """

    object: str
    counted: bool
    weight: float
    room: str
    room_nats: float
    runner_up: str | None
    runner_up_nats: float | None

    @property
    def difference_nats(self) -> float:
        """Above 0 it speaks for the best room, below 0 for the runner-up."""
        if self.runner_up_nats is None or self.runner_up_nats == self.room_nats:
            return 0.0  # −inf less −inf too: it rules out both
        return self.room_nats - self.runner_up_nats

    def as_json(self) -> dict[str, Any]:
        return asdict(self) | {"difference_nats": self.difference_nats}


class Prediction:
    """The room that a rule chose, and why; what costs time is computed when asked for.

    Attributes
    ----------
    room : the label, or ``None`` where nothing can answer, or the answer is too unsure
    reason : why a room is left without an answer that there is; ``None`` otherwise
    unknown_objects : names, as given, that nothing could make use of
    answered_by : ``table``, ``lm`` or ``none``
    """

    __slots__ = (
        "_compared", "_decider", "_known", "answered_by", "reason", "room", "unknown_objects",
    )  # fmt: skip

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
        self.reason: str | None = None

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
        if self.answered_by == NONE:
            return None
        if self._compared is None:
            ranks = [known for known in self._known if isinstance(known, int)]
            self._compared = self._decider.compare(ranks)
        return np.asarray(self._compared, np.float64)

    @property
    def temperature(self) -> float:
        """What divides the compared numbers before they become probabilities.

        ``auto`` under rule ``pooled`` is Σ w(o): the weights then add up to 1, and the pool is the
        objects' weighted geometric mean instead of their product, which takes for granted that
        they are independent.
        """
        wanted = self._decider.decision.temperature
        if wanted != AUTO:
            return wanted
        total = sum(known.weight for known in self.known_objects) if self._decider.pools else 1.0
        return total or 1.0

    @property
    def probabilities(self) -> dict[str, float]:
        """Softmax over the candidate rooms of what the rule compares; empty if unanswered."""
        compared = self.compared
        if compared is None:
            return {}
        values = np.exp(log_softmax(compared / self.temperature)).tolist()
        return dict(zip(self._decider.room_names, values, strict=True))

    @property
    def probability(self) -> float | None:
        """The probability of the best room, also if that is too unsure to be the answer."""
        return max(self.probabilities.values(), default=None)

    @property
    def evidence(self) -> tuple[Evidence, ...]:
        """What each object says for the best room and against the runner-up; empty if unanswered.

        Under rule ``pooled`` the numbers add up to what is compared. The other rules score one
        sentence as a whole: there they are what each object says alone.
        """
        compared = self.compared
        if compared is None:
            return ()
        best, runner_up = [*np.argsort(-compared, kind="stable").tolist(), None][:2]
        names, pools = self._decider.room_names, self._decider.pools
        return tuple(
            Evidence(
                known.label.label,
                pools or place < self._decider.k,
                known.weight,
                names[best],
                float(known.evidence[best]),
                None if runner_up is None else names[runner_up],
                None if runner_up is None else float(known.evidence[runner_up]),
            )
            for place, known in enumerate(self.known_objects)
        )

    def weighed(self, factors: Mapping[str, float]) -> Prediction:
        """The same room under rule ``pooled`` with objects' weights times a factor, by label."""
        known = [
            replace(o, evidence=f * o.evidence, weight=f * o.weight)
            if (f := factors.get(o.label.label, 1.0))
            else replace(o, evidence=np.zeros_like(o.evidence), weight=0.0)
            for o in self.known_objects
        ]
        if not known:
            return self
        compared = np.add.reduce([o.evidence for o in known], axis=0)
        room = self._decider.room_names[int(compared.argmax())]
        return Prediction(
            self._decider, room, self.answered_by, known, self.unknown_objects, compared
        )

    def unless_unsure(self) -> Prediction:
        """The prediction, or one without a room where that is below the decision's minimum."""
        least = self._decider.decision.min_probability
        probability = self.probability
        if self.room is None or probability is None or probability >= least:
            return self
        unsure = Prediction(
            self._decider, None, self.answered_by, self._known, self.unknown_objects, self._compared
        )
        unsure.reason = f"{self.room} has probability {probability:.3g}, below {least:g}"
        return unsure

    def top(self, n: int) -> list[tuple[str, float]]:
        """The ``n`` most probable rooms, best first."""
        return sorted(self.probabilities.items(), key=lambda item: (-item[1], item[0]))[:n]

    def as_json(self, room_id: str | None = None) -> dict[str, Any]:
        """The prediction under the contract's keys."""
        probabilities = self.probabilities
        unsure = {"reason": self.reason} if self._decider.decision.min_probability else {}
        return {
            "room_id": room_id,
            "room": self.room,
            "probability": max(probabilities.values(), default=None),
            "probabilities": probabilities,
            "objects": list(self.objects),
            "unknown_objects": list(self.unknown_objects),
            "rule": self.rule,
            "source": self.source,
            "answered_by": self.answered_by,
            **unsure,
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
