"""Label rooms: pick the most informative objects, look the combination up, ask the model if not.

One open maps the published tables; the language model is loaded on the first miss, if at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import RoomLabel
from roomtables.online import batch
from roomtables.online.decision import Decision, TableDecider
from roomtables.online.model import QueryModel
from roomtables.online.model_pass import OpenVocabulary, Question
from roomtables.online.names import UNLISTED, Vocabulary, as_names
from roomtables.online.prediction import NONE, TABLE, Prediction, Predictions
from roomtables.scorer import Scorer
from roomtables.storage.lookup import Lookup
from roomtables.storage.misses import FOLDER, MissLog
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version

_BATCH = 1 << 13  # rooms worked on at once: their arrays fit the processor's cache
# What a decision takes from the build's settings where nothing else is said.
_SETTINGS = ("rule", "source", "prior_weight", "evidence_power")
_ATTEMPTS = 20  # opens, while a build removes the version that CURRENT named a moment ago


class RoomTables:
    """Published tables of one label space, opened for lookup. Threads may share one.

    Examples
    --------
    >>> tables = RoomTables.open("tables", labels="mpcat40")  # doctest: +SKIP
    >>> tables.classify(["toilet", "sink"]).room  # doctest: +SKIP
    'bathroom'
    """

    def __init__(
        self,
        version: Version,
        lookup: Lookup,
        model: QueryModel,
        decision: Decision,
        misses: MissLog | None = None,
    ) -> None:
        self.version = version
        self.lookup = lookup
        self.decision = decision
        self._model = model
        self._misses = misses
        self._decider = TableDecider(lookup, decision, model)
        self._open = OpenVocabulary(self._decider, model, misses)
        self._vocabulary = Vocabulary(lookup.object_aliases, self._decider.ranks())
        self._rank_of = self._vocabulary.__getitem__

    @classmethod
    def open(
        cls,
        tables: str | Path = "tables",
        labels: str = "mpcat40",
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
        labels : the label space's name, or its folder, whose base name is its name
        scorer : a language model for misses; by default the one the tables were built with
        offline : never load a language model
        verify : read and hash every byte of the lookup files first
        note_misses : append to ``misses/`` each combination that no table holds
        decision : ``rule``, ``source``, ``prior_weight`` (λ), ``evidence_power`` (γ), ``rooms``
            (candidates), ``temperature``, ``min_probability``; what is absent is as the build's
            settings say

        Raises
        ------
        StoreError
            Nothing is published, or it is damaged or of another label space or schema version.
        InputError
            A candidate room is unknown and no model may be asked about it.
        """
        space = _space(Path(tables), Path(labels).name)
        version, lookup = _open_published(space, verify)
        misses = MissLog(space.path / FOLDER) if note_misses else None
        model = QueryModel(version.manifest, scorer, allowed=not offline)
        built = version.manifest.settings
        settings: dict[str, Any] = {name: getattr(built, name) for name in _SETTINGS}
        settings |= {name: value for name, value in decision.items() if value is not None}
        return cls(version, lookup, model, Decision(**settings), misses)

    def deciding(self, **changes: Any) -> RoomTables:
        """The same tables and model under another rule, source, λ, γ or candidates."""
        decision = replace(self.decision, **changes)
        return RoomTables(self.version, self.lookup, self._model, decision, self._misses)

    @property
    def candidates(self) -> tuple[RoomLabel, ...]:
        """The rooms that may be the answer, sorted by label."""
        return self._decider.candidates.rooms

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
        known = sorted(ranks)
        if not (unlisted and self._open.can_ask()):
            compared = self._decider.compare(known)
            unknown = tuple(unlisted.values())
            if compared is not None:
                # Rooms are sorted and argmax takes the first: a tie goes to the first label.
                room = self._decider.room_names[compared.argmax()]
                found = Prediction(self._decider, room, TABLE, known, unknown, compared)
                return found.unless_unsure() if self.decision.min_probability else found
            if not known:
                return Prediction(self._decider, None, NONE, known, unknown)
        answer = self._open.answer([Question(known, unlisted)])[0]
        return answer.unless_unsure() if self.decision.min_probability else answer

    def classify_many(self, rooms: Iterable[Iterable[str]]) -> Predictions:
        """Label rooms; whatever no table holds is scored in one batched pass of the model.

        Raises
        ------
        InputError
            The objects of a room are not a list of strings.
        """
        names = [as_names(objects) for objects in rooms]
        ranks, lengths = batch.ranks_of(names, self._vocabulary)
        ends = np.cumsum(lengths)
        starts = ends - lengths
        best, some = self._best(ranks, lengths)
        unlisted = self._unlisted(names, ranks, ends)
        left = set(np.flatnonzero((best < 0) & some).tolist())
        left |= unlisted.keys() if unlisted and self._open.can_ask() else set()

        def known(at: int) -> list[int]:
            return sorted(set(ranks[starts[at] : ends[at]].tolist()) - {UNLISTED})

        open_ = sorted(left)
        asked = self._open.answer([Question(known(at), unlisted.get(at, {})) for at in open_])
        answers = dict(zip(open_, asked, strict=True))

        def predict(at: int) -> Prediction:
            if at in answers:
                return answers[at]
            unknown = tuple(unlisted.get(at, {}).values())
            by = NONE if labels[at] is None else TABLE
            return Prediction(self._decider, labels[at], by, known(at), unknown)

        room_names: Sequence[str | None] = (*self._decider.room_names, None)
        labels = [room_names[place] for place in best.tolist()]  # −1, unanswered, is the last
        for at, prediction in answers.items():
            labels[at] = prediction.room
        if self.decision.min_probability:
            sure = [predict(at).unless_unsure() for at in range(len(labels))]
            return Predictions([prediction.room for prediction in sure], sure.__getitem__)
        return Predictions(labels, predict)

    def _best(
        self, ranks: NDArray[np.int64], lengths: NDArray[np.intp]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """The best candidate of each room, −1 for none, and whether it has a known object."""
        best = np.full(len(lengths), -1)
        some = np.zeros(len(lengths), np.bool_)
        ends = np.cumsum(lengths)
        for start in range(0, len(lengths), _BATCH):
            rooms = slice(start, start + _BATCH)
            sizes = lengths[rooms]
            first = int(ends[start] - lengths[start])
            part = ranks[first : first + int(sizes.sum())]
            if self._decider.pools:
                total, some[rooms] = batch.summed(self._decider.evidence, part, sizes)
                best[rooms] = np.where(some[rooms], total.argmax(axis=1), -1)
            else:
                picked = batch.most_informative(part, sizes, self.lookup.k)
                some[rooms] = picked[:, 0] > 0
                best[rooms] = self._decider.best_of_many(picked)
        return best, some

    def _unlisted(
        self, names: Sequence[Sequence[str]], ranks: NDArray[np.int64], ends: NDArray[np.intp]
    ) -> dict[int, dict[str, str]]:
        """By room, the names that no object bears: normalised → as given."""
        places = np.flatnonzero(ranks == UNLISTED)
        rooms = dict.fromkeys(np.searchsorted(ends, places, side="right").tolist())
        found = {at: self._vocabulary.unlisted(names[at]) for at in rooms}
        return {at: unlisted for at, unlisted in found.items() if unlisted}


def _space(tables: Path, labels: str) -> SpaceFolder:
    unpacked = tables / "tables"
    inside = not (tables / labels).is_dir() and (unpacked / labels).is_dir()
    return SpaceFolder(unpacked if inside else tables, labels)


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
