"""Causal language models: which strategy scores them, and proof that it does so rightly."""

from __future__ import annotations

from collections.abc import Sequence

from roomtables.lm.encoding import Encoder
from roomtables.lm.forward import FloatArray, Forward
from roomtables.lm.progress import Meter
from roomtables.lm.sequences import sort_sequences
from roomtables.lm.strategies import padded


class CausalBackend:
    """Sum of log p(token | tokens before it) over a sentence's scored tokens."""

    def __init__(self, forward: Forward, encoder: Encoder, budget: int) -> None:
        self.forward = forward
        self.encoder = encoder
        self.strategy = "padded"
        self.fallbacks: list[str] = []

    def encode(self, sentences: Sequence[str]) -> list[list[int]]:
        return self.encoder.encode(sentences)

    def token_count(self, encoded: Sequence[int]) -> int:
        return len(encoded) - 1

    def log_probs(self, encoded: Sequence[Sequence[int]], budget: int, meter: Meter) -> FloatArray:
        sequences, index = sort_sequences(encoded)
        return padded(self.forward, sequences, budget, meter)[index]
