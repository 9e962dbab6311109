"""How a room is decided, from the definitions, with floats and loops: the tables' reference."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel, normalise
from roomtables.names import NameReader, as_spoken
from roomtables.sentences import Template

Score = Callable[[str], float]


@dataclass
class Answer:
    """What a room should be answered with."""

    room: str | None
    probabilities: dict[str, float]
    objects: list[str]
    unknown: list[str]
    answered_by: str
    rule: str
    read_as: dict[str, str]


@dataclass
class PlainDecision:
    """One rule and source.

    ``smoothing`` is added to every count (``None``: 1 / number of rooms); ``combinations`` are
    those in the tables (``None``: all). ``rooms`` are the candidates; of those that the
    label space does not list, ``score`` is asked. Names are read as ``NameReader`` says.
    """

    space: LabelSpace
    score: Score
    counts: Mapping[tuple[str, str], float]
    rule: str
    source: str
    prior_weight: float = 0.5
    evidence_power: float = 3.0
    rooms: Sequence[str] = ()
    combinations: set[frozenset[str]] | None = None
    model: bool = False
    backoff: bool = True
    k: int = 3
    smoothing: float | None = None
    _unlisted: dict[str, ObjectLabel] = field(default_factory=dict)

    def answer(self, names: Sequence[str]) -> Answer:
        known, unknown = self._resolve(names)
        ordered = sorted(known, key=lambda name: (round(self._entropy(name), 10), name))
        picked = ordered[: self.k]
        candidates = sorted(self.rooms) or [r.label for r in self.space.predicted_rooms]
        found = {name: self._read(name) for name in names}
        read_as = {name: label for name, label in found.items() if label and label != name}
        compared, by = self._compare(ordered, picked, candidates)
        rule = self.rule
        if compared is None and self.backoff:
            rule = "pooled"
            compared, by = replace(self, rule=rule)._compare(ordered, picked, candidates)
        if compared is None:
            return Answer(None, {}, picked, unknown, "none", self.rule, read_as)
        best = max(compared.values())
        room = min(name for name in candidates if compared[name] == best)
        probabilities = _softmax(compared)
        return Answer(room, probabilities, picked, unknown, by, rule, read_as)

    def _read(self, name: str) -> str | None:
        found = NameReader(self.space.object_names).read(name)
        return found and found.label

    def _resolve(self, names: Sequence[str]) -> tuple[list[str], list[str]]:
        known: list[str] = []
        unknown: dict[str, str] = {}
        for name in names:
            spelled = normalise(name)
            label = self._read(name)
            if label is None and spelled and self.model and self.source == "proxy":
                label = as_spoken(name)
                self._unlisted[label] = ObjectLabel.named(label)
            if label is not None:
                known.append(label)
            elif spelled:
                unknown.setdefault(spelled, name)
        return sorted(set(known)), list(unknown.values())

    def _compare(
        self, ordered: Sequence[str], picked: Sequence[str], candidates: Sequence[str]
    ) -> tuple[dict[str, float] | None, str]:
        if not ordered:
            return None, "none"
        asks = any(name in self._unlisted for name in ordered)
        if self.rule == "pooled":
            pooled = dict.fromkeys(candidates, 0.0)
            for name in ordered:
                for room, value in self._evidence(name, candidates).items():
                    pooled[room] += value
            return pooled, "lm" if asks else "table"
        tabled = (
            not any(name in self._unlisted for name in picked)
            and set(candidates) <= {room.label for room in self.space.predicted_rooms}
            and (self.combinations is None or frozenset(picked) in self.combinations)
        )
        if not (tabled or self.model):
            return None, "none"
        nouns = [self._label(name) for name in picked]
        compared = {}
        for room in candidates:
            value = self.score(Template().compose(nouns, [self._room(room)])[0])
            # Tables hold single precision; the model's own answer is not rounded.
            compared[room] = struct.unpack("f", struct.pack("f", value))[0] if tabled else value
        if self.rule == "calibrated":
            bias = self._bias(candidates)
            compared = {r: v - self.prior_weight * bias[r] for r, v in compared.items()}
        return compared, "table" if tabled else "lm"

    def _label(self, name: str) -> ObjectLabel:
        listed = {o.label: o for o in self.space.objects}
        return listed.get(name) or self._unlisted[name]

    def _room(self, name: str) -> RoomLabel:
        listed = {room.label: room for room in self.space.rooms}
        return listed.get(name) or RoomLabel.named(name)

    def _single(self, name: str, room: str) -> float:
        """S(o, r), or log p(r | o) of counts."""
        if self.source == "proxy":
            return self._single_score(name, room)
        rooms = [r.label for r in self.space.rooms]
        smoothing = 1 / len(rooms) if self.smoothing is None else self.smoothing
        rows = {r: self.counts.get((name, r), 0) + smoothing for r in rooms}
        if sum(rows.values()) == 0:  # never seen: it says nothing
            return -math.log(len(rooms))
        return math.log(rows[room] / sum(rows.values())) if rows[room] else -math.inf

    def _single_score(self, name: str, room: str) -> float:
        return self.score(Template().compose([self._label(name)], [self._room(room)])[0])

    def _entropy(self, name: str) -> float:
        p = _softmax({room.label: self._single(name, room.label) for room in self.space.rooms})
        return max(-sum(v * math.log(v) for v in p.values() if v > 0), 0.0)

    def _log_likelihood(self, name: str, rooms: Sequence[str]) -> dict[str, float]:
        return _log_softmax({room: self._single(name, room) for room in rooms})

    def _bias(self, candidates: Sequence[str]) -> dict[str, float]:
        """The model's bias towards rooms, whatever the source.

        A candidate that is not listed takes part in the softmax; that moves b of all rooms alike.
        """
        predicted = [room.label for room in self.space.predicted_rooms]
        rooms = dict.fromkeys([*predicted, *candidates])
        rows = [
            _log_softmax({room: self._single_score(o.label, room) for room in rooms})
            for o in self.space.objects
        ]
        return {room: sum(row[room] for row in rows) / len(rows) for room in candidates}

    def _evidence(self, name: str, candidates: Sequence[str]) -> dict[str, float]:
        weight = self.prior_weight if self.source == "proxy" else 0.0
        bias = self._bias(candidates)
        likelihood = self._log_likelihood(name, candidates)
        adjusted = _log_softmax({r: likelihood[r] - weight * bias[r] for r in candidates})
        entropy = -sum(math.exp(v) * v for v in adjusted.values() if math.exp(v) > 0)
        informative = max(math.log(len(candidates)) - entropy, 0.0) ** self.evidence_power
        return {room: informative * v if informative else 0.0 for room, v in adjusted.items()}


def _softmax(scores: Mapping[str, float]) -> dict[str, float]:
    return {name: math.exp(value) for name, value in _log_softmax(scores).items()}


def _log_softmax(scores: Mapping[str, float]) -> dict[str, float]:
    highest = max(scores.values())
    if highest == -math.inf:
        return dict.fromkeys(scores, -math.log(len(scores)))
    total = math.log(sum(math.exp(value - highest) for value in scores.values()))
    return {name: value - highest - total for name, value in scores.items()}
