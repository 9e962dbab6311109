"""The scorer that users hold: streams sentences through a backend in windows of bounded size.

A window is deduplicated, scored in the order that is cheapest, and handed back in the order given.
Windows and the packing inside them depend on the input and the token budget alone, so a rebuild on
the same machine gives the same scores.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
import torch

from roomtables.errors import ModelError
from roomtables.packing.sequences import FloatArray
from roomtables.packing.tokens import IntArray
from roomtables.packing.windows import Asked, unzipped, windows
from roomtables.progress import progress_bar
from roomtables.scorer import ONE_THREAD_PARAMETERS, SentenceScore
from roomtables.token_limits import quoted

_log = logging.getLogger(__name__)

SMALLEST_BUDGET = 16
_SENTENCES_PER_TOKEN = 16  # a window's sentences for each token of the budget
_LARGEST_WINDOW = 1 << 16


class Backend(Protocol):
    """What differs between causal and masked language models."""

    @property
    def strategy(self) -> str:
        """How sentences are run through the model: ``trie``, ``kv``, ``padded``, …"""
        ...

    @property
    def fallbacks(self) -> Sequence[str]:
        """Why faster strategies were passed over, one line each."""
        ...

    def encode(self, sentences: Sequence[str], starts: Sequence[int] | None = None) -> Any:
        """Tokens of each sentence, and which of them are scored.

        Raises
        ------
        ModelError
            A sentence cannot be scored.
        """
        ...

    def token_counts(self, encoded: Any) -> IntArray:
        """How many tokens of each encoded sentence are scored."""
        ...

    def log_probs(self, encoded: Any, budget: int, meter: Meter) -> FloatArray:
        """Sum of log probabilities in nats of each sentence's scored tokens, ``[sentences]``.

        ``budget`` is the most tokens in one forward pass.
        """
        ...


class SentenceScorer:
    """Implements :class:`roomtables.scorer.Scorer`; made by :func:`roomtables.lm.load_scorer`."""

    def __init__(
        self,
        backend: Backend,
        *,
        scorer_id: str,
        provenance: Mapping[str, str],
        token_budget: int,
        threads: int,
        progress: bool = False,
    ) -> None:
        self.backend = backend
        self.token_budget = token_budget
        self.threads = threads
        self.progress = progress
        self.window = min(_LARGEST_WINDOW, max(256, _SENTENCES_PER_TOKEN * token_budget))
        self._scorer_id = scorer_id
        self._provenance = dict(provenance)

    @property
    def scorer_id(self) -> str:
        """Names the scorer up to everything that changes a score; a folder's name."""
        return self._scorer_id

    @property
    def strategy(self) -> str:
        """The path in use: ``trie``, ``kv``, ``padded``, ``naive`` or ``masked``."""
        return self.backend.strategy

    def describe(self) -> Mapping[str, str]:
        """Provenance for a manifest: model, revision, dtype, device, strategy, versions."""
        return dict(self._provenance)

    def score(
        self, sentences: Sequence[str], starts: Sequence[int] | None = None
    ) -> list[SentenceScore]:
        """Scores (nats) in the order given.

        ``starts`` are the characters from which tokens count; see
        :meth:`roomtables.scorer.Scorer.score`.

        Raises
        ------
        ModelError
            A sentence is empty or longer than the model's context, no token of it counts, a score
            is not finite, or memory runs out even for the smallest token budget.
        """
        return list(self.score_stream(sentences, starts))

    def score_stream(
        self,
        sentences: Iterable[str],
        starts: Iterable[int] | None = None,
        *,
        total: int | None = None,
    ) -> Iterator[SentenceScore]:
        """One score per sentence, in order, lazily and in bounded memory; raises as :meth:`score`.

        ``total`` is the number of sentences, for the estimate of the time left; read from
        ``sentences`` where it has a length. A progress bar is labelled by their attribute ``what``.
        """
        if total is None and isinstance(sentences, Sized):
            total = len(sentences)
        what = getattr(sentences, "what", "scoring")
        meter = Meter(total, what if self.progress else None)
        try:
            for window in windows(sentences, starts, self.window):
                yield from self._score_window(window, meter)
        finally:
            meter.close()

    def _score_window(self, window: list[Asked], meter: Meter) -> list[SentenceScore]:
        unique = list(dict.fromkeys(window))
        encoded = self.backend.encode(*unzipped(unique))
        counts = self.backend.token_counts(encoded)
        meter.begin(len(window), int(counts.sum()))
        with using_threads(self.threads):
            log_probs = self._log_probs(encoded, meter)
        bad = np.flatnonzero(~np.isfinite(log_probs))
        if len(bad):
            raise ModelError(
                f"{self.scorer_id} gives {quoted(unique[bad[0]][0])} a log probability of "
                f"{log_probs[bad[0]]}; try --dtype float32, or another --model"
            )
        meter.finish()
        scores = map(SentenceScore, log_probs.tolist(), counts.tolist())
        found = dict(zip(unique, scores, strict=True))
        return [found[asked] for asked in window]

    def _log_probs(self, encoded: Any, meter: Meter) -> FloatArray:
        """Score a window, with half the token budget whenever memory runs out."""
        while True:
            try:
                return self.backend.log_probs(encoded, self.token_budget, meter)
            except (torch.cuda.OutOfMemoryError, RuntimeError, MemoryError) as error:
                if not _out_of_memory(error):
                    raise
                if self.token_budget <= SMALLEST_BUDGET:
                    raise ModelError(
                        f"{self.scorer_id} runs out of memory even at {self.token_budget} tokens "
                        "a pass; try --dtype float16, or a smaller --model"
                    ) from error
            self.token_budget = max(SMALLEST_BUDGET, self.token_budget // 2)
            _log.warning("out of memory: going on with %d tokens a pass", self.token_budget)
            if torch.cuda.is_available():
                torch.cuda.empty_cache()


def _out_of_memory(error: Exception) -> bool:
    if isinstance(error, torch.cuda.OutOfMemoryError | MemoryError):
        return True
    return "can't allocate memory" in str(error) or "not enough memory" in str(error)


class Meter:
    """Counts what is done of a stream of sentences, window by window.

    A progress bar on stderr, labelled ``what``, shows sentences, the time left, for which ``total``
    sentences must be known, tokens run, and the share of tokens that shared prefixes save. Without
    a label there is none.
    """

    def __init__(self, total: int | None = None, what: str | None = None) -> None:
        self.tokens_asked = 0
        self.tokens_run = 0
        self._finished = 0
        self._bar: Any = None if what is None else progress_bar(what, total)

    def begin(self, sentences: int, tokens: int) -> None:
        """A window of ``sentences`` holding ``tokens`` is about to be scored."""
        self._window = sentences
        self._window_tokens = tokens
        self._share = 0.0

    def part(self, share: float) -> Meter:
        """A meter for ``share`` (0 to 1) of the window's work."""
        return _Part(self, share)

    def advance(self, share: float, tokens_run: int) -> None:
        """``share`` (0 to 1) of the window's work is done; the model ran ``tokens_run`` for it."""
        self._share = min(1.0, self._share + share)
        self.tokens_run += tokens_run
        self._show(self._finished + int(self._share * self._window))

    def finish(self) -> None:
        """The window's scores are known."""
        self._finished += self._window
        self.tokens_asked += self._window_tokens
        self._show(self._finished)

    def _show(self, sentences: int) -> None:
        if self._bar is None:
            return
        asked = self.tokens_asked or self._share * self._window_tokens
        saved = 1 - self.tokens_run / asked if asked else 0.0
        self._bar.set_postfix_str(
            f"{self.tokens_run:,} tokens run, {max(saved, 0.0):.0%} saved", refresh=False
        )
        self._bar.update(max(0, sentences - self._bar.n))

    def close(self) -> None:
        """Leave the bar as it stands."""
        if self._bar is not None:
            self._bar.close()


class _Part(Meter):
    """Forwards to a whole meter what is done of a share of its window."""

    def __init__(self, whole: Meter, share: float) -> None:
        super().__init__()
        self._whole = whole
        self._part_share = share

    def advance(self, share: float, tokens_run: int) -> None:
        self._whole.advance(share * self._part_share, tokens_run)


def threads_for(parameters: int, device: str) -> int:
    """Threads for a model of this size: the same on every run, so that scores are too."""
    return 1 if device == "cpu" and parameters < ONE_THREAD_PARAMETERS else torch.get_num_threads()


@contextmanager
def using_threads(count: int) -> Iterator[None]:
    """Run torch with ``count`` threads for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
