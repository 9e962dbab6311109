"""What roomtables asks of a language model: the log probability of a sentence.

``roomtables.lm`` implements the protocol with torch, ``roomtables.onnx_lm`` with ONNX Runtime;
tests implement it with a few lines of arithmetic. Importing this module loads neither torch nor
numpy.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from roomtables.schemas import AFTER_ROOM, SENTENCE

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


def kept_as(scorer_id: str, scored: str) -> str:
    """The identity that a scorer's scores are kept under: its own, marked where only what stands
    behind the room counts (``scored``, one of :data:`roomtables.schemas.SCORED`)."""
    return scorer_id if scored == SENTENCE else f"{scorer_id}-{scored}"


def scored_by(kept: str) -> str:
    """The ``scorer_id`` in an identity that scores are kept under: :func:`kept_as` undone."""
    return kept.removesuffix(f"-{AFTER_ROOM}")


@runtime_checkable
class Scorer(Protocol):
    """Scores sentences, or the ends of sentences (paper equation 1).

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

    def score(
        self, sentences: Sequence[str], starts: Sequence[int] | None = None
    ) -> list[SentenceScore]:
        """Scores in the order given.

        ``starts`` are the characters from which tokens count, one for each sentence: what stands
        before is read, and not scored. Counted is a token that begins at its sentence's start or
        behind it. A space that a token begins with is no part of it here: where " sinks" is one
        token, it begins with the "s", in whatever tokenizer. A token that begins before the start
        and ends behind it does not count. ``None``: all tokens count. A causal model's first token,
        which nothing stands before, never does.

        Raises
        ------
        ModelError
            A sentence is empty or longer than the model's context, no token of it counts, or a
            score is not finite.
        """
        ...

    def score_stream(
        self, sentences: Iterable[str], starts: Iterable[int] | None = None
    ) -> Iterator[SentenceScore]:
        """The same, lazily and in bounded memory: one score per sentence, in order.

        Sentences that come with a length let the scorer estimate the time left.
        """
        ...
