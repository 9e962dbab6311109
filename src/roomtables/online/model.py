"""The language model behind a published version, loaded on the first question that needs it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.scorer import Scorer
from roomtables.sentences import Template
from roomtables.storage.manifest import Manifest

MOST_ANSWERS = 4096
"""Answers that are kept in memory, the latest: some 3 MB with 45 rooms."""

Query = tuple[Sequence[ObjectLabel], Sequence[RoomLabel]]
_Key = tuple[tuple[str, ...], tuple[RoomLabel, ...]]


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
        self._template = Template(manifest.settings.template[0])
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
        """S of the sentences about objects and each of some rooms, in one batched pass.

        Returns one array ``[rooms]`` in nats per query, read-only; ``None`` where there is no
        model.

        Raises
        ------
        ModelError
            The model cannot score a sentence.
        """
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

    def _ask(self, scorer: Scorer, queries: Collection[Query]) -> list[NDArray[np.float64]]:
        sentences = [self._template.compose(objects, rooms) for objects, rooms in queries]
        scores = iter(scorer.score([text for texts in sentences for text in texts]))
        answers = []
        for texts in sentences:
            answer = np.array([next(scores).reduced(self._reduction) for _ in texts])
            answer.flags.writeable = False  # handed out again
            answers.append(answer)
        return answers


def _key(query: Query) -> _Key:
    """What the sentences of a query hold of the objects; and the rooms, a tuple that is shared."""
    objects, rooms = query
    return tuple(label.plural for label in objects), tuple(rooms)


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
