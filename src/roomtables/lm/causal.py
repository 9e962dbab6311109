"""Causal language models: the strategies to try on a model, and the one that passed its check."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from roomtables.lm.encoding import Encoder
from roomtables.lm.forward import Forward
from roomtables.lm.scorer import Meter
from roomtables.lm.selfcheck import choose
from roomtables.lm.strategies import ROW_NODES, Strategy, key_value, naive, padded, trie
from roomtables.packing.sequences import FloatArray, Sequences, sort_sequences
from roomtables.packing.tokens import Encoded, IntArray


class CausalBackend:
    """Sum of log p(token | tokens before it) over a sentence's scored tokens (paper equation 1).

    The fastest strategy that agrees with naive scoring is chosen when the backend is made;
    ``fallbacks`` says why the faster ones were passed over. Strategy ``trie`` packs rows of
    ``row_nodes``, and only sequences no longer than the model's attention ``window``, if any.

    Raises
    ------
    ModelError
        The model cannot score a plain token sequence, or its scores are not finite.
    """

    def __init__(self, forward: Forward, encoder: Encoder, budget: int) -> None:
        self.forward = forward
        self.encoder = encoder
        candidates = _candidates(forward.model.config.get_text_config(), encoder.context)
        self.strategy, self._run, self.fallbacks = choose(candidates, forward, encoder, budget)
        packing: dict[str, Any] = getattr(self._run, "keywords", {})
        self.row_nodes: int | None = packing.get("row_nodes")
        self.window: int | None = packing.get("window")

    def encode(self, sentences: Sequence[str], starts: Sequence[int] | None = None) -> Encoded:
        """Token ids of each sentence, and which are scored; see :meth:`Encoder.encode`."""
        return self.encoder.encode(sentences, starts)

    def token_counts(self, encoded: Encoded) -> IntArray:
        """How many tokens of each encoded sentence are scored."""
        return encoded.counts

    def log_probs(self, encoded: Encoded, budget: int, meter: Meter) -> FloatArray:
        """Log probability in nats of each encoded sentence's scored tokens, ``[sentences]``."""
        sequences, index = sort_sequences(*encoded)
        return self._run(self.forward, sequences, budget, meter)[index]


# Not `max_window_layers` or `sliding_window_pattern`, which count layers.
_WINDOW_KEYS = ("window", "window_size", "chunk_size")


def _candidates(config: Any, context: int | None) -> list[tuple[str, Strategy]]:
    """Strategies by falling speed. Some attend by column within a row, so rows get a second try
    no longer than the model's attention window or context."""
    window = _attention_window(config)
    narrow = min(ROW_NODES, window or ROW_NODES, context or ROW_NODES)
    tries = [
        ("trie", partial(_trie_or_padded, row_nodes=nodes, window=window))
        for nodes in dict.fromkeys([ROW_NODES, narrow])
    ]
    return [*tries, ("kv", key_value), ("padded", padded), ("naive", naive)]


def _attention_window(config: Any) -> int | None:
    """The shortest distance over which some layer attends, where one is limited."""
    sizes = [
        size
        for key, size in config.to_dict().items()
        if key.endswith(_WINDOW_KEYS) and type(size) is int and size > 0
    ]
    return min(sizes, default=None)


def _trie_or_padded(
    forward: Forward,
    sequences: Sequences,
    budget: int,
    meter: Meter,
    *,
    row_nodes: int,
    window: int | None,
) -> FloatArray:
    """The trie; sequences too long for half a row, or for the attention window, are padded."""
    row_nodes = min(row_nodes, budget)
    packed = sequences.lengths <= min(row_nodes // 2, window or row_nodes)
    scores = np.empty(len(sequences))
    if packed.any():
        scores[packed] = trie(
            forward, sequences.take(packed), budget, meter.part(packed.mean()), row_nodes
        )
    if not packed.all():
        scores[~packed] = padded(
            forward, sequences.take(~packed), budget, meter.part((~packed).mean())
        )
    return scores
