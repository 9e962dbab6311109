"""The build's language model: identified from its files, loaded when it has to score."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from roomtables.config import BuildConfig
from roomtables.scorer import Scorer


class LazyScorer:
    """A scorer that costs nothing until a sentence is missing from the cache."""

    def __init__(self, config: BuildConfig, given: Scorer | None = None) -> None:
        self._config = config
        self._scorer = given
        self._scorer_id = given.scorer_id if given else None

    @property
    def scorer_id(self) -> str:
        """The identity, from the files of the model alone."""
        if self._scorer_id is None:
            from roomtables.lm import identify

            self._scorer_id = identify(self._config.model, **self._settings())
        return self._scorer_id

    def load(self, progress: bool = False) -> Scorer:
        """The scorer itself; with ``progress`` one loaded here shows its own progress bar.

        Raises
        ------
        ModelError, MissingExtraError
            The model cannot be loaded, or torch is not installed.
        """
        if self._scorer is None:
            from roomtables.lm import load_scorer

            self._scorer = load_scorer(
                self._config.model,
                token_budget=self._config.token_budget,
                progress=progress,
                **self._settings(),
            )
        return self._scorer

    def describe(self) -> Mapping[str, str]:
        """Provenance, where the model was loaded at all."""
        return dict(self._scorer.describe()) if self._scorer else {}

    def _settings(self) -> dict[str, Any]:
        names = ("revision", "dtype", "device", "scoring")
        return {name: getattr(self._config, name) for name in names}
