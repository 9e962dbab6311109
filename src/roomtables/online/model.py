"""The language model behind a published version, loaded on the first question that needs it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import MissingExtraError
from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.scorer import Scorer
from roomtables.sentences import Template
from roomtables.storage.manifest import Manifest

log = logging.getLogger(__name__)


class QueryModel:
    """Scores sentences that no table holds; where it cannot, it says so once.

    Threads may share one: a scorer is asked by one at a time.

    Parameters
    ----------
    manifest : of the version whose tables it completes
    scorer : the language model; by default the one that the tables were built with
    allowed : whether one may be loaded
    """

    def __init__(
        self, manifest: Manifest, scorer: Scorer | None = None, allowed: bool = True
    ) -> None:
        self._manifest = manifest
        self._scorer = scorer
        self._allowed = allowed
        self._template = Template(manifest.settings.template[0])
        self._reduction: str = manifest.settings.reduction
        self._loading = threading.Lock()
        self._scoring = threading.Lock()

    @property
    def labels(self) -> str:
        """The name of the label space."""
        return self._manifest.labels

    @property
    def extends_tables(self) -> bool:
        """Whether its scores are comparable with those of the co-occurrence tables."""
        return self._manifest.extends_tables

    def load(self) -> Scorer | None:
        """The scorer, or ``None`` where none is allowed or installed.

        Raises
        ------
        ModelError
            The model that the tables were built with cannot be loaded.
        """
        with self._loading:
            if self._scorer is None and self._allowed:
                self._scorer = self._load()
                self._allowed = self._scorer is not None
            return self._scorer

    def score(
        self, queries: Sequence[tuple[Sequence[ObjectLabel], Sequence[RoomLabel]]]
    ) -> list[NDArray[np.float64]] | None:
        """S of the sentences about objects and each of some rooms, in one batched pass.

        Returns one array ``[rooms]`` in nats per query; ``None`` where there is no model.
        """
        scorer = self.load()
        if scorer is None:
            return None
        sentences = [self._template.compose(objects, rooms) for objects, rooms in queries]
        with self._scoring:
            scores = iter(scorer.score([text for texts in sentences for text in texts]))
        return [
            np.array([next(scores).reduced(self._reduction) for _ in texts]) for texts in sentences
        ]

    def _load(self) -> Scorer | None:
        settings = self._manifest.settings
        try:
            from roomtables.lm import load_scorer

            scorer = load_scorer(
                settings.model,
                revision=settings.revision,
                dtype=settings.dtype,
                device="auto",
                scoring=settings.scoring,
            )
        except (ImportError, MissingExtraError):
            log.warning(
                "no language model here, so what no table holds stays unanswered; "
                "run `pip install 'roomtables[lm]'`, or pass --offline"
            )
            return None
        expected = self._manifest.query_scorer_id
        if expected not in {None, scorer.scorer_id}:
            log.warning(
                "the tables were scored by %s, the model here is %s; run `roomtables build`",
                expected, scorer.scorer_id,
            )  # fmt: skip
        return scorer
