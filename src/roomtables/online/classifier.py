"""Label rooms: pick the most informative objects, look the combination up, ask the model if not.

One open maps the published tables; the language model is loaded on the first miss, if at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.config import check_decision
from roomtables.errors import ConfigError, InputError, StoreError
from roomtables.labels import ObjectLabel, RoomLabel, normalise
from roomtables.online import rules
from roomtables.online.model import QueryModel
from roomtables.online.prediction import LM, NONE, TABLE, Prediction
from roomtables.schemas import CALIBRATED, ENTROPY_DECIMALS, POOLED, PROXY, RULES
from roomtables.scorer import Scorer
from roomtables.store import LOOKUP, SpaceFolder, Version
from roomtables.twin import SourceArrays, Twin, key_bits

# Beyond this length a string is no object's name, and beyond this many unlisted names a room is
# no room: the model is not asked about the rest.
_LONGEST_NAME = 100
_MOST_UNLISTED = 50


@dataclass(frozen=True)
class Decision:
    """How to decide: the rule, whose co-occurrence, λ, γ, and the candidate rooms (all: none)."""

    rule: str
    source: str
    prior_weight: float
    evidence_power: float
    rooms: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Object:
    """An object of a room as a rule sees it."""

    label: ObjectLabel
    rank_key: tuple[float, str]
    rank: int | None
    evidence: NDArray[np.float64]


@dataclass
class _Question:
    """A room on its way to an answer."""

    known: list[_Object]
    unlisted: list[ObjectLabel]
    unknown: list[str]

    def picked(self, k: int) -> list[_Object]:
        return sorted(self.known, key=lambda o: o.rank_key)[:k]


class RoomTables:
    """Published tables of one label space, opened for lookup.

    Examples
    --------
    >>> tables = RoomTables.open("tables", labels="mpcat40")  # doctest: +SKIP
    >>> tables.classify(["toilet", "sink"]).room  # doctest: +SKIP
    'bathroom'
    """

    def __init__(self, version: Version, twin: Twin, model: QueryModel, decision: Decision) -> None:
        if decision.rule not in RULES:
            raise ConfigError(f"no rule {decision.rule!r}; use one of {', '.join(RULES)}")
        if decision.source not in twin.sources:
            raise StoreError(
                f"{version.path} holds no source {decision.source!r} "
                f"(only {', '.join(twin.sources)}); run `roomtables build --counts FILE.csv`"
            )
        check_decision(decision.prior_weight, decision.evidence_power)
        self.version = version
        self.twin = twin
        self.decision = decision
        self._model = model
        self._arrays: SourceArrays = twin.sources[decision.source]
        self._object_ids = {o.label: number for number, o in enumerate(twin.objects)}
        self._predicted = [number for number, room in enumerate(twin.rooms) if room.predicted]
        self.candidates = self._candidates(decision.rooms)
        self._prepare()

    @classmethod
    def open(
        cls,
        tables: str | Path = "tables",
        labels: str = "mpcat40",
        *,
        scorer: Scorer | None = None,
        offline: bool = False,
        **decision: Any,
    ) -> RoomTables:
        """Open the published version of a label space.

        Parameters
        ----------
        tables : the tables folder
        labels : the label space's name, or its folder, whose base name is its name
        scorer : a language model for misses; by default the one the tables were built with
        offline : never load a language model
        decision : ``rule``, ``source``, ``prior_weight`` (λ), ``evidence_power`` (γ), ``rooms``
            (candidates); what is absent is as the build's settings say

        Raises
        ------
        StoreError
            Nothing is published, or it is damaged or of another schema version.
        InputError
            A candidate room is unknown and no model may be asked about it.
        """
        version = SpaceFolder(Path(tables), Path(labels).name).current()
        twin = Twin.open(version.path / LOOKUP)
        model = QueryModel(version.manifest, scorer, allowed=not offline)
        settings = dict(version.manifest["decision"])
        settings |= {name: value for name, value in decision.items() if value is not None}
        return cls(version, twin, model, Decision(**settings))

    def deciding(self, **changes: Any) -> RoomTables:
        """The same tables and model under another rule, source, λ, γ or candidates."""
        return RoomTables(self.version, self.twin, self._model, replace(self.decision, **changes))

    def classify(self, objects: Iterable[str]) -> Prediction:
        """Label one room from the names of the objects in it, in any order."""
        return self.classify_many([objects])[0]

    def classify_many(self, rooms: Iterable[Iterable[str]]) -> list[Prediction]:
        """Label rooms; whatever no table holds is scored in one batched pass of the model."""
        questions = [self._resolve(objects) for objects in rooms]
        self._ask_about_unlisted(questions)
        if self.decision.rule == POOLED:
            return [self._pool(question) for question in questions]
        return self._query(questions)

    # -- candidates ----------------------------------------------------------------------------

    def _candidates(self, names: Sequence[str]) -> tuple[RoomLabel, ...]:
        """The candidate rooms, sorted by label: all predicted rooms, or those asked for."""
        if not names:
            return tuple(self.twin.rooms[number] for number in self._predicted)
        by_label = {room.label: room for room in self.twin.rooms}
        chosen = {}
        for name in names:
            label = self.twin.room_aliases.get(normalise(name), normalise(name))
            if not label:
                raise InputError(
                    "an empty room name among `--rooms`; write `--rooms kitchen,office`"
                )
            chosen[label] = by_label.get(label) or RoomLabel.named(label)
        return tuple(chosen[label] for label in sorted(chosen))

    def _prepare(self) -> None:
        """Scores and bias over the candidates, and the evidence of each object."""
        columns = {self.twin.rooms[n].label: at for at, n in enumerate(self._predicted)}
        labels = [room.label for room in self.candidates]
        self._room_names = tuple(labels)
        self._in_tables = all(label in columns for label in labels)
        if self._in_tables:
            self._columns = np.array([columns[label] for label in labels])
            object_room = self._arrays.object_room[:, self._predicted][:, self._columns]
            bias = self._arrays.bias[self._columns]
        else:
            object_room = self._ask_about_rooms()
            bias = rules.room_bias(object_room)
        self._bias = np.asarray(bias)
        weight = self.decision.prior_weight if self.decision.source == PROXY else 0.0
        self._prior_weight = weight
        self._evidence = rules.pooled_evidence(
            np.asarray(object_room), self._bias, weight, self.decision.evidence_power
        )

    def _ask_about_rooms(self) -> NDArray[np.float64]:
        """S(o, r) for candidates of which some are in no table, ``[objects, candidates]``."""
        unlisted = [room.label for room in self.candidates if room not in self.twin.rooms]
        unpredicted = [room.label for room in self.candidates if not room.predicted]
        if unpredicted and not unlisted:
            raise InputError(
                f"room {unpredicted[0]!r} is never predicted in label space "
                f"{self.version.manifest['labels']}; leave it out of `--rooms`"
            )
        usable = self.decision.source == PROXY and self._model.extends_tables
        asked = [([o], self.candidates) for o in self.twin.objects]
        scores = self._model.score(asked) if usable else None
        if scores is None:
            raise InputError(
                f"no table knows room {unlisted[0]!r}, and there is no model to ask; add it to "
                "rooms.csv and run `roomtables build`, or leave it out of `--rooms`"
            )
        return np.stack(scores)

    # -- objects -------------------------------------------------------------------------------

    def _resolve(self, objects: Iterable[str]) -> _Question:
        """Known objects once each; names that no table knows, once each."""
        known: set[str] = set()
        unlisted: dict[str, str] = {}
        for name in objects:
            spelled = normalise(name)
            label = self.twin.object_aliases.get(spelled)
            if label is not None:
                known.add(label)
            elif spelled:
                unlisted.setdefault(spelled, name)
        question = _Question([self._listed(label) for label in known], [], [])
        askable = self.decision.source == PROXY and self._model.extends_tables
        for spelled, name in unlisted.items():
            fits = len(spelled) <= _LONGEST_NAME and len(question.unlisted) < _MOST_UNLISTED
            if askable and fits and self._model.load() is not None:
                question.unlisted.append(ObjectLabel.named(spelled))
            else:
                question.unknown.append(name)
        return question

    def _listed(self, label: str) -> _Object:
        number = self._object_ids[label]
        rank = int(self._arrays.ranks[number])
        entropy = round(float(self._arrays.entropy[number]), ENTROPY_DECIMALS)
        return _Object(self.twin.objects[number], (entropy, label), rank, self._evidence[number])

    def _ask_about_unlisted(self, questions: Sequence[_Question]) -> None:
        """Score the single-object sentences of unlisted names, in one pass, and rank them."""
        names = {o.label: o for question in questions for o in question.unlisted}
        if not names:
            return
        rooms = (*self.twin.rooms, *(r for r in self.candidates if r not in self.twin.rooms))
        scores = self._model.score([([o], rooms) for o in names.values()]) or []
        columns = [rooms.index(room) for room in self.candidates]
        found = {}
        for o, row in zip(names.values(), scores, strict=True):
            over_rooms = rules.log_softmax(row[: len(self.twin.rooms)])
            entropy = round(float(rules.entropy(over_rooms)), ENTROPY_DECIMALS)
            evidence = rules.pooled_evidence(
                row[columns], self._bias, self._prior_weight, self.decision.evidence_power
            )
            found[o.label] = _Object(o, (entropy, o.label), None, evidence)
        for question in questions:
            question.known += [found[o.label] for o in question.unlisted]

    # -- rules ---------------------------------------------------------------------------------

    def _pool(self, question: _Question) -> Prediction:
        """Rule ``pooled``: the evidence of all the room's objects, summed."""
        if not question.known:
            return self._predict(question, None, NONE)
        ordered = sorted(question.known, key=lambda o: o.rank_key)
        compared = np.sum([o.evidence for o in ordered], axis=0)
        return self._predict(question, compared, LM if question.unlisted else TABLE)

    def _query(self, questions: Sequence[_Question]) -> list[Prediction]:
        """Rules ``query`` and ``calibrated``: the query sentence's scores, looked up or asked."""
        picked = [question.picked(self.twin.k) for question in questions]
        found = [self._look_up(objects) for objects in picked]
        missed = [at for at, row in enumerate(found) if row is None and picked[at]]
        asked = [([o.label for o in picked[at]], self.candidates) for at in missed]
        answers = dict(
            zip(missed, (self._model.score(asked) if asked else None) or [], strict=False)
        )
        predictions = []
        for at, question in enumerate(questions):
            scores = found[at] if found[at] is not None else answers.get(at)
            by = TABLE if found[at] is not None else LM if scores is not None else NONE
            if scores is not None and self.decision.rule == CALIBRATED:
                scores = rules.calibrated(scores, self._bias, self.decision.prior_weight)
            predictions.append(self._predict(question, scores, by))
        return predictions

    def _look_up(self, picked: Sequence[_Object]) -> NDArray[np.float64] | None:
        """The scores of a combination over the candidates, or ``None`` if no table holds it."""
        if not picked or not self._in_tables:
            return None
        key = 0
        for at in range(self.twin.k):
            rank = picked[at].rank if at < len(picked) else 0
            if rank is None:
                return None
            key = key << key_bits(self.twin.k) | rank
        keys = self._arrays.keys
        row = int(np.searchsorted(keys, np.uint64(key)))
        if row == len(keys) or keys[row] != key:
            return None
        scores: NDArray[np.float64] = self._arrays.scores[row][self._columns].astype(np.float64)
        return scores

    def _predict(
        self, question: _Question, compared: NDArray[np.float64] | None, answered_by: str
    ) -> Prediction:
        return Prediction(
            self._room_names,
            compared,
            tuple(o.label.label for o in question.picked(self.twin.k)),
            tuple(question.unknown),
            self.decision.rule,
            self.decision.source,
            answered_by,
        )
