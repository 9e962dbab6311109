"""The language model behind a published version, loaded on the first question that needs it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.online import rules
from roomtables.scorer import Scorer, SentenceScore
from roomtables.sentences import Template
from roomtables.storage.manifest import Manifest

MOST_ANSWERS = 4096
"""Answers that are kept in memory, the latest: some 3 MB with 45 rooms."""

Query = tuple[Sequence[ObjectLabel], Sequence[RoomLabel]]
_Worded = tuple[Template, Sequence[ObjectLabel], Sequence[RoomLabel]]
_Key = tuple[Template, tuple[str, ...], tuple[RoomLabel, ...]]


class QueryModel:
    """Scores sentences that no table holds; where it cannot, it says so once.

    A combination is asked of the model once: the latest answers are kept in memory.

    Threads may share one: a scorer is asked by one at a time.

    Parameters
    ----------
    manifest : of the version whose tables it completes
    scorer : the language model; by default the one that the tables were built with
    allowed : whether one may be loaded
    version : the folder of the version, which may hold the model in ONNX
    """

    def __init__(
        self,
        manifest: Manifest,
        scorer: Scorer | None = None,
        allowed: bool = True,
        version: Path | None = None,
    ) -> None:
        self._manifest = manifest
        self._version = version
        self._scorer = scorer
        self._allowed = allowed
        self._templates = tuple(map(Template, manifest.settings.template))
        self._scored: str = manifest.settings.scored
        self._reduction: str = manifest.settings.reduction
        self._loading = threading.Lock()
        self._scoring = threading.Lock()
        self._answers = _Answers(MOST_ANSWERS)

    @property
    def labels(self) -> str:
        """The name of the label space."""
        return self._manifest.labels

    @property
    def extends_tables(self) -> bool:
        """Whether its scores are comparable with those of the co-occurrence tables."""
        return self._manifest.extends_tables

    def load(self) -> Scorer | None:
        """The scorer; ``None`` where none is allowed, installed, or the one that made the tables.

        Never raises for a model that is missing, damaged or another: it warns, once.
        """
        with self._loading:
            if self._scorer is None and self._allowed:
                from roomtables.online.model_choice import ModelChoice

                self._scorer = ModelChoice(self._manifest, self._version).load()
                self._allowed = self._scorer is not None
            return self._scorer

    def score(self, queries: Sequence[Query]) -> list[NDArray[np.float64]] | None:
        """S of the query sentences about objects and each of some rooms, in one batched pass.

        They have the first template. Returns one array ``[rooms]`` in nats per query, read-only;
        ``None`` where there is no model.

        Raises
        ------
        ModelError
            The model cannot score a sentence.
        """
        return self._score([(self._templates[0], *query) for query in queries])

    def score_singles(
        self,
        objects: Sequence[ObjectLabel],
        rooms: Sequence[RoomLabel],
        space: Sequence[RoomLabel],
    ) -> list[NDArray[np.float64]] | None:
        """S(o, r) of single objects as the co-occurrence tables hold it, in one batched pass.

        Of several templates it depends on all rooms of the label space, ``space``. Returns and
        raises as :meth:`score`.
        """
        asked = tuple(rooms)
        if len(self._templates) > 1:
            asked = (*space, *(room for room in rooms if room not in space))
        worded = [(template, [label], asked) for label in objects for template in self._templates]
        scores = self._score(worded)
        if scores is None:
            return None
        shape = (len(objects), len(self._templates), len(asked))
        found = rules.over_templates(np.array(scores).reshape(shape), len(space))
        return list(found[:, [asked.index(room) for room in rooms]])

    def _score(self, queries: Sequence[_Worded]) -> list[NDArray[np.float64]] | None:
        scorer = self.load()
        if scorer is None:
            return None
        keys = [_key(query) for query in queries]
        found = self._answers.get(keys)
        if any(answer is None for answer in found):
            with self._scoring:
                found = self._answers.get(keys)  # another thread may have asked the same
                missing = {
                    key: query
                    for key, query, answer in zip(keys, queries, found, strict=True)
                    if answer is None
                }
                asked = dict(zip(missing, self._ask(scorer, missing.values()), strict=True))
                self._answers.put(asked)
            found = [
                asked[key] if answer is None else answer
                for key, answer in zip(keys, found, strict=True)
            ]
        return [answer for answer in found if answer is not None]

    def _ask(self, scorer: Scorer, queries: Collection[_Worded]) -> list[NDArray[np.float64]]:
        sentences = [template.compose(objects, rooms) for template, objects, rooms in queries]
        starts = [template.starts(rooms, self._scored) for template, _, rooms in queries]
        scores = iter(_scores(scorer, sentences, starts))
        answers = []
        for texts in sentences:
            answer = np.array([next(scores).reduced(self._reduction) for _ in texts])
            answer.flags.writeable = False  # handed out again
            answers.append(answer)
        return answers


def _scores(
    scorer: Scorer, sentences: Iterable[list[str]], starts: Iterable[list[int] | None]
) -> list[SentenceScore]:
    """The scores of all sentences, one group after the other."""
    texts = list(chain.from_iterable(sentences))
    from_character = list(chain.from_iterable(some or () for some in starts))
    return scorer.score(texts, from_character) if from_character else scorer.score(texts)


def _key(query: _Worded) -> _Key:
    """What the sentences of a query hold of the objects; and the rooms, a tuple that is shared."""
    template, objects, rooms = query
    return template, tuple(label.plural for label in objects), tuple(rooms)


class _Answers:
    """The latest answers, by what was asked."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: OrderedDict[_Key, NDArray[np.float64]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, keys: Sequence[_Key]) -> list[NDArray[np.float64] | None]:
        with self._lock:
            for key in keys:
                if key in self._held:
                    self._held.move_to_end(key)
            return [self._held.get(key) for key in keys]

    def put(self, answers: Mapping[_Key, NDArray[np.float64]]) -> None:
        with self._lock:
            self._held.update(answers)
            while len(self._held) > self._most:
                self._held.popitem(last=False)
