"""What roomtables asks of a language model: the log probability of a sentence.

``roomtables.lm`` implements the protocol with torch, ``roomtables.onnx_lm`` with ONNX Runtime;
tests implement it with a few lines of arithmetic. Importing this module loads neither torch nor
numpy.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

DTYPES = ("float32", "float16", "bfloat16", "float64")
"""Number formats that a language model can compute in."""

SCORINGS = ("causal", "pll", "pll_word_l2r")
"""How a sentence is scored: left to right (causal models), or as a pseudo-log-likelihood (masked
models), plain or with the rest of a word masked along with its earlier pieces."""

SCORING_RULE_VERSION = "1"
"""Raise it whenever what is scored changes: which tokens, the BOS rule, the masking rule."""

TOLERANCE_NATS = 1e-3
"""How far apart two ways of scoring a sentence with one model may be."""

# Below this many parameters a matrix product is shorter than the wait for a second thread: one
# thread is as fast on an idle machine, and over ten times as fast where another process is busy.
ONE_THREAD_PARAMETERS = 20_000_000


class SentenceScore(NamedTuple):
    """Log probability of a sentence in nats, summed over its ``token_count`` scored tokens."""

    log_prob: float
    token_count: int

    def reduced(self, reduction: str) -> float:
        """The score S in nats: the sum of log probabilities, or their mean per scored token."""
        return self.log_prob if reduction == "sum" else self.log_prob / self.token_count


@runtime_checkable
class Scorer(Protocol):
    """Scores whole sentences (paper equation 1).

    ``scorer_id`` names the scorer up to everything that changes a score: weights, configuration,
    tokenizer, BOS rule, scoring rule, compute dtype, device class. It is a folder name.
    """

    @property
    def scorer_id(self) -> str: ...

    @property
    def strategy(self) -> str:
        """The path in use: ``trie``, ``kv``, ``padded``, … (equal scores, unequal speed)."""
        ...

    def describe(self) -> Mapping[str, str]:
        """Provenance for a manifest: model, revision, dtype, device, scoring, versions."""
        ...

    def score(self, sentences: Sequence[str]) -> list[SentenceScore]:
        """Scores in the order given.

        Raises
        ------
        ModelError
            A sentence is empty or longer than the model's context, or a score is not finite.
        """
        ...

    def score_stream(self, sentences: Iterable[str]) -> Iterator[SentenceScore]:
        """The same, lazily and in bounded memory: one score per sentence, in order.

        Sentences that come with a length let the scorer estimate the time left.
        """
        ...
