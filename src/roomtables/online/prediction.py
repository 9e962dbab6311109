"""What roomtables says of one room, or of many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from roomtables.online.decider import (
    BackoffDecider,
    Decider,
    UnlistedObject,
    WeighedObjects,
)
from roomtables.online.decision import AUTO
from roomtables.online.rules import log_softmax

# What answered: the tables, the language model, or nothing.
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


@dataclass(slots=True, eq=False, repr=False)
class Prediction:
    """The room that a rule chose, and by which numbers; why is computed when asked for.

    Attributes
    ----------
    decider : the tables under the decision that was made, which can explain the answer
    room : the label, or ``None`` where nothing can answer, or the answer is too unsure
    answered_by : ``table``, ``lm`` or ``none``
    ranks : of the room's listed objects, ascending
    given : the names of the room's objects
    unknown_objects : names, as given, that nothing could make use of
    compared : ``[candidates]``, what the rule compared, in nats; ``None`` if unanswered
    unlisted : the room's objects that only the model knows
    weight_factors : of the objects' weights, by label; 1 for those left out
    reason : why a room is left without an answer that there is; ``None`` otherwise
    """

    decider: Decider
    room: str | None
    answered_by: str
    ranks: Sequence[int]
    given: tuple[str, ...]
    unknown_objects: tuple[str, ...] = ()
    compared: NDArray[np.floating[Any]] | None = None
    unlisted: tuple[UnlistedObject, ...] = ()
    weight_factors: Mapping[str, float] | None = None
    reason: str | None = None

    @property
    def rule(self) -> str:
        """The rule that decided."""
        return self.decider.decision.rule

    @property
    def backed_off(self) -> bool:
        """Whether rule ``pooled`` decided, because nothing could answer by the rule asked for."""
        return isinstance(self.decider, BackoffDecider)

    @property
    def read_as(self) -> dict[str, str]:
        """Given name → label of the listed object, for each name that is not itself the label."""
        return self.decider.read_as(self.given)

    @property
    def source(self) -> str:
        """Whose co-occurrence decided."""
        return self.decider.decision.source

    @property
    def objects(self) -> tuple[str, ...]:
        """The picked objects, most informative first: also their order in the sentence."""
        return tuple(picked.label for picked in self.decider.pick(self.ranks, self.unlisted))

    @property
    def temperature(self) -> float:
        """What divides the compared numbers before they become probabilities.

        ``auto`` under rule ``pooled`` is Σ w(o): the weights then add up to 1, and the pool is the
        objects' weighted geometric mean instead of their product, which takes for granted that
        they are independent.
        """
        wanted = self.decider.decision.temperature
        if wanted != AUTO:
            return wanted
        total = float(self._weighed_objects.weights.sum()) if self.decider.pools else 1.0
        return total or 1.0

    @property
    def probabilities(self) -> dict[str, float]:
        """Softmax over the candidate rooms of what the rule compares; empty if unanswered."""
        if self.compared is None:
            return {}
        compared = np.asarray(self.compared, np.float64)
        best = compared.max()
        with np.errstate(over="ignore"):  # a temperature near 0: all but the best get 0
            scaled = (compared - (best if np.isfinite(best) else 0.0)) / self.temperature
        values = np.exp(log_softmax(scaled)).tolist()
        return dict(zip(self.decider.candidates.names, values, strict=True))

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
        if self.compared is None:
            return ()
        best, *others = self._ranking(self.compared)
        second = others[0] if others else None
        names, said = self.decider.candidates.names, self._weighed_objects
        counted = len(said.labels) if self.decider.pools else self.decider.lookup.k
        return tuple(
            Evidence(
                label,
                place < counted,
                float(said.weights[place]),
                names[best],
                float(said.evidence[place, best]),
                None if second is None else names[second],
                None if second is None else float(said.evidence[place, second]),
            )
            for place, label in enumerate(said.labels)
        )

    @property
    def _weighed_objects(self) -> WeighedObjects:
        return self.decider.weigh(self.ranks, self.unlisted, self.weight_factors)

    def answered(self, compared: NDArray[np.floating[Any]], answered_by: str) -> Prediction:
        """The same room, answered with the best of what was compared."""
        room = self.decider.best_room(compared)
        return replace(self, room=room, compared=compared, answered_by=answered_by, reason=None)

    def backed_off_by(self, decider: Decider) -> Prediction:
        """The same room, answered from the tables by the decider that backs another off."""
        compared = decider.compare(self.ranks)
        if compared is None:
            return self
        return replace(self, decider=decider, unlisted=()).answered(compared, TABLE)

    def weighed(self, factors: Mapping[str, float]) -> Prediction:
        """The same room under rule ``pooled`` with objects' weights times a factor, by label."""
        if self.compared is None:
            return self
        factored = replace(self, weight_factors=factors)
        return factored.answered(factored._weighed_objects.compared, self.answered_by)

    def unless_unsure(self) -> Prediction:
        """The prediction, or one without a room where that is below the decision's minimum."""
        least = self.decider.decision.min_probability
        probability = self.probability
        if self.room is None or probability is None or probability >= least:
            return self
        reason = f"{self.room} has probability {probability:.3g}, below {least:g}"
        return replace(self, room=None, reason=reason)

    def best(self, n: int) -> tuple[str, ...]:
        """The ``n`` best rooms by what the rule compares, ties by label; empty if unanswered."""
        if self.compared is None:
            return ()
        return tuple(self.decider.candidates.names[at] for at in self._ranking(self.compared)[:n])

    @staticmethod
    def _ranking(compared: NDArray[np.floating[Any]]) -> list[int]:
        """The candidates' places, best first; they are sorted by label, and so are ties."""
        places: list[int] = np.argsort(-compared, kind="stable").tolist()
        return places

    def top(self, n: int) -> list[tuple[str, float]]:
        """The ``n`` most probable rooms, best first."""
        return sorted(self.probabilities.items(), key=lambda item: (-item[1], item[0]))[:n]

    def as_json(self, room_id: str | None = None) -> dict[str, Any]:
        """The prediction under the contract's keys."""
        probabilities = self.probabilities
        unsure = {"reason": self.reason} if self.decider.decision.min_probability else {}
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
            "read_as": self.read_as,
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
