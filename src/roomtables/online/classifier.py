"""Label rooms: pick the most informative objects, look their combination up, else ask the model.

Opening maps the published tables; the language model is loaded on the first miss, if at all.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import ConfigError, StoreError
from roomtables.labels import RoomLabel
from roomtables.names import NameReader, as_spoken
from roomtables.online import rules
from roomtables.online.decider import Decider
from roomtables.online.decision import Decision
from roomtables.online.model import QueryModel
from roomtables.online.model_pass import ModelPass, Question
from roomtables.online.names import UNLISTED, as_names
from roomtables.online.prediction import TABLE, Prediction, Predictions
from roomtables.online.ranks import ABSENT, RankedRooms
from roomtables.rooms import COUNTS, Room
from roomtables.schemas import POOLED
from roomtables.scorer import Scorer
from roomtables.storage.lookup import Lookup
from roomtables.storage.miss_log import FOLDER, MissLog
from roomtables.storage.spaces import find_space
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version

# What a decision takes from the build's settings where nothing else is said.
_SETTINGS = ("rule", "source", "prior_weight", "evidence_power")
_ATTEMPTS = 20  # opens, while a build removes the version that CURRENT named a moment ago


class RoomTables:
    """Published tables of one label space, opened for lookup. Threads may share one.

    :meth:`open` opens them; :meth:`deciding` gives the same tables under another rule or source.

    Attributes
    ----------
    version : the published version that was opened
    lookup : its mapped lookup
    decision : how rooms are decided
    names : what reads the names of objects
    """

    def __init__(
        self,
        version: Version,
        lookup: Lookup,
        model: QueryModel,
        decision: Decision,
        misses: MissLog | None = None,
        names: NameReader | None = None,
    ) -> None:
        self.version = version
        self.lookup = lookup
        self.decision = decision
        self.names = names or NameReader(lookup.object_names())
        self._model = model
        self._misses = misses
        self._decider = Decider.choose(lookup, decision, model, self.names)
        self._model_pass = ModelPass(self._decider, model, misses)
        self._vocabulary = self._decider.vocabulary
        self._rank_of = self._vocabulary.__getitem__

    @classmethod
    def open(
        cls,
        tables: str | Path = "tables",
        labels: str | None = None,
        *,
        scorer: Scorer | None = None,
        offline: bool = False,
        verify: bool = False,
        note_misses: bool = True,
        **decision: Any,
    ) -> RoomTables:
        """Open the published version of a label space.

        Parameters
        ----------
        tables : the tables folder, or the folder that an export was unpacked into
        labels : the label space's name, or its folder, whose base name is its name; by default
            ``household`` where it is published, else the only one that is
        scorer : a language model for misses; by default the one the tables were built with
        offline : never load a language model
        verify : read and hash every byte of the lookup files first
        note_misses : append to ``misses/`` each combination that no table holds
        decision : ``rule``, ``source``, ``prior_weight`` (λ), ``evidence_power`` (γ), ``rooms``
            (candidates), ``temperature``, ``min_probability``, ``backoff``; what is absent is as
            the build's settings say

        Raises
        ------
        StoreError
            Nothing is published, or it is damaged or of another label space or schema version.
        InputError
            A candidate room is unknown and no model may be asked about it.
        """
        space = _space(Path(tables), labels)
        version, lookup = _open_published(space, verify)
        misses = MissLog(space.path / FOLDER) if note_misses else None
        model = QueryModel(version.manifest, scorer, not offline, version.path)
        built = version.manifest.settings
        settings: dict[str, Any] = {name: getattr(built, name) for name in _SETTINGS}
        settings |= {name: value for name, value in decision.items() if value is not None}
        return cls(version, lookup, model, Decision(**settings), misses)

    def deciding(self, **changes: Any) -> RoomTables:
        """The same tables and model under another rule, source, λ, γ or candidates."""
        decision = replace(self.decision, **changes)
        return RoomTables(
            self.version, self.lookup, self._model, decision, self._misses, self.names
        )

    @property
    def candidates(self) -> tuple[RoomLabel, ...]:
        """The rooms that may be the answer, sorted by label."""
        return self._decider.candidates.rooms

    def load_model(self) -> bool:
        """Load the language model, if one may be asked; whether there is one."""
        return self._model.load() is not None

    def classify(self, objects: Iterable[str]) -> Prediction:
        """Label one room from the names of the objects in it, in any order.

        Raises
        ------
        InputError
            The objects are not a list of strings.
        """
        names = as_names(objects)
        ranks = set(map(self._rank_of, names))
        unlisted = {}
        if UNLISTED in ranks:
            ranks.discard(UNLISTED)
            unlisted = self._vocabulary.unlisted(names)
        answer = self._answer(sorted(ranks), unlisted, names)
        return answer.unless_unsure() if self.decision.min_probability else answer

    def classify_many(self, rooms: Iterable[Iterable[str]]) -> Predictions:
        """Label rooms; whatever no table holds is scored in one batched pass of the model.

        Without a model, rule ``pooled`` decides those rooms, all at once.

        Raises
        ------
        InputError
            The objects of a room are not a list of strings.
        """
        names = [as_names(objects) for objects in rooms]
        ranked = RankedRooms.of(names, self._vocabulary)
        best = self._decider.best_of_many(ranked)
        unlisted = {at: self._vocabulary.unlisted(names[at]) for at in ranked.with_unlisted()}

        def question(at: int) -> Question:
            return Question(ranked.listed(at), unlisted.get(at, {}), names[at])

        for_model: set[int] = set()
        if any(unlisted.values()) and self._model_pass.ranks_unlisted():
            for_model.update(at for at, spelled in unlisted.items() if spelled)
        missed = self._missed(ranked, best)
        backed_off: set[int] = set()
        if len(missed) and self._model_pass.has_model():
            for_model.update(missed.tolist())
        elif len(missed):
            best[missed] = self._model_pass.back_off_many(ranked.only(missed))
            backed_off.update(missed.tolist())
        asked = sorted(for_model)
        answers: dict[int, Prediction] = dict(
            zip(asked, self._model_pass.answer(map(question, asked)), strict=True)
        )

        def predict(at: int) -> Prediction:
            if at in answers:
                return answers[at]
            if at in backed_off:
                return self._model_pass.back_off(question(at))
            return self._answer(*question(at))

        room_names = (*self._decider.candidates.names, None)  # ABSENT is the last
        labels = [room_names[place] for place in best.tolist()]
        for at, answer in answers.items():
            labels[at] = answer.room
        if self.decision.min_probability:
            sure = [predict(at).unless_unsure() for at in range(len(labels))]
            return Predictions([prediction.room for prediction in sure], sure.__getitem__)
        return Predictions(labels, predict)

    def _missed(self, ranked: RankedRooms, best: NDArray[np.int64]) -> NDArray[np.int64]:
        """The rooms that have a listed object, and no answer in the tables."""
        absent = np.flatnonzero(best == ABSENT)
        if not len(absent):
            return absent
        return absent[ranked.only(absent).most_informative(1)[:, 0] > 0]

    def _answer(
        self, ranks: Sequence[int], unlisted: Mapping[str, str], given: tuple[str, ...]
    ) -> Prediction:
        """The answer for listed objects, by rank ascending, and names that no table lists."""
        ask = unlisted and self._model_pass.ranks_unlisted()
        compared = None if ask else self._decider.compare(ranks)
        if compared is None:
            return self._model_pass.answer([Question(ranks, unlisted, given)])[0]
        room = self._decider.best_room(compared)
        unknown = tuple(unlisted.values())
        return Prediction(self._decider, room, TABLE, ranks, given, unknown, compared)


def _space(tables: Path, labels: str | None) -> SpaceFolder:
    """The label space's folder under a tables folder, or under what an export was unpacked into."""
    space, unpacked = find_space(tables, labels), find_space(tables / "tables", labels)
    return unpacked if unpacked.path.is_dir() and not space.path.is_dir() else space


def _open_published(space: SpaceFolder, verify: bool) -> tuple[Version, Lookup]:
    """The version that ``CURRENT`` names, and its lookup.

    Builds may publish others and remove this one before it is opened; ``CURRENT`` tells.
    """
    for _ in range(_ATTEMPTS):
        named = space.pointer()
        try:
            return _open_version(space, verify)
        except StoreError:
            if space.pointer() == named:
                raise
    return _open_version(space, verify)


def _open_version(space: SpaceFolder, verify: bool) -> tuple[Version, Lookup]:
    version = space.current()
    labels = version.manifest.labels
    if labels != space.labels:
        raise StoreError(
            f"{version.path} holds tables of label space {labels}, not {space.labels}; "
            f"run `roomtables build --labels {space.labels} --full-refresh`"
        )
    return version, Lookup.open(version.path / LOOKUP, version.manifest, verify)


def classify_rooms(
    tables: RoomTables, rooms: Sequence[Room], weights: str | None = None
) -> Sequence[Prediction]:
    """Label rooms, in order; ``weights`` is ``counts``, ``confidences``, or ``None`` for neither.

    Both multiply the weight w(o) of rule ``pooled``: a detection by its confidence, objects of a
    kind by :func:`~roomtables.online.rules.count_factor` of their number. With counts, an object
    named twice counts twice; of several confidences the highest counts. A room without these
    numbers has one of each object, surely detected.

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
    factors = [_factors(room, weights, tables.names) for room in rooms]
    predictions = tables.classify_many([room.objects for room in rooms])
    return [
        prediction.weighed(of_room).unless_unsure()
        for prediction, of_room in zip(predictions, factors, strict=True)
    ]


def _factors(room: Room, weights: str, names: NameReader) -> dict[str, float]:
    """The factor of each object's weight, by label."""
    measured: dict[str, list[float]] = defaultdict(list)
    for name, value in zip(room.objects, room.measured(weights), strict=True):
        found = names.read(name)
        measured[as_spoken(name) if found is None else found.label].append(value)
    if weights == COUNTS:
        return {label: rules.count_factor(sum(values)) for label, values in measured.items()}
    return {label: max(values) for label, values in measured.items()}
