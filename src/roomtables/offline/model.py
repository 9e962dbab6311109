"""The language model of a build: named at once, loaded when the cache lacks a sentence."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from roomtables.config import BuildConfig
from roomtables.errors import MissingExtraError, ModelError
from roomtables.lm.folders import EMBEDDED_FOLDER, EMBEDDED_MODEL
from roomtables.onnx_lm import OnnxScorer
from roomtables.scorer import Scorer, kept_as, scored_by

log = logging.getLogger(__name__)


class LazyScorer:
    """A scorer that costs nothing until a sentence is missing from the cache.

    The embedded model is run from its ONNX file where its identity is the file's, that is in
    float32 on a CPU: that takes less time a sentence, and none to import torch and transformers.
    With ``token_budget``, which an ONNX file does not heed, it runs on torch.

    Attributes
    ----------
    shows_progress : whether the scorer itself shows the progress that :meth:`load` was asked for
    """

    def __init__(self, config: BuildConfig, given: Scorer | None = None) -> None:
        self._config = config
        self._scorer = given
        self.shows_progress = True
        self._scorer_id = kept_as(given.scorer_id, config.scored) if given else None

    @property
    def scorer_id(self) -> str:
        """What its scores are kept under, from the model's files and what is scored."""
        if self._scorer_id is None:
            from roomtables.lm import identify

            found = identify(self._config.model, **self._settings())
            self._scorer_id = kept_as(found, self._config.scored)
        return self._scorer_id

    def load(self, progress: bool = False) -> Scorer:
        """The scorer itself; with ``progress`` one on torch shows its own progress bar.

        Raises
        ------
        ModelError, MissingExtraError
            The model cannot be loaded, or torch is not installed.
        """
        if self._scorer is None:
            self._scorer = self._from_onnx() or self._from_torch(progress)
        return self._scorer

    def _from_onnx(self) -> Scorer | None:
        config = self._config
        if config.model != EMBEDDED_MODEL or config.dtype != "float32" or config.token_budget:
            return None
        try:
            scorer = OnnxScorer.open(EMBEDDED_FOLDER)
        except MissingExtraError:
            return None
        except ModelError as error:
            log.warning("%s; until then the model runs on torch", error)
            return None
        if scorer.scorer_id != scored_by(self.scorer_id):
            return None
        self.shows_progress = False
        return scorer

    def _from_torch(self, progress: bool) -> Scorer:
        from roomtables.lm import load_scorer

        return load_scorer(
            self._config.model,
            token_budget=self._config.token_budget,
            progress=progress,
            **self._settings(),
        )

    def describe(self) -> Mapping[str, str]:
        """Provenance, where the model was loaded at all."""
        return dict(self._scorer.describe()) if self._scorer else {}

    def _settings(self) -> dict[str, Any]:
        names = ("revision", "dtype", "device", "scoring")
        return {name: getattr(self._config, name) for name in names}
