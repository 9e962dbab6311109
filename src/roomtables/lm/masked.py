"""Masked language models: pseudo-log-likelihood (Salazar et al. 2020).

Each scored token is masked in turn and read from a bidirectional pass over everything else, so
there is no prefix to share; but sentences that differ in the masked word alone share the input.
``whole_words`` also masks the later tokens of the token's own word (``within_word_l2r``, Kauf and
Ivanova 2023), which keeps a long word from being read off its own remainder.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from roomtables.errors import ModelError
from roomtables.lm.encoding import Encoder
from roomtables.lm.forward import Forward
from roomtables.lm.scorer import Meter
from roomtables.lm.selfcheck import agree, in_float32
from roomtables.packing.sequences import FloatArray, batches_by_length
from roomtables.packing.tokens import IntArray, first_counted

_log = logging.getLogger(__name__)

CHECK_SENTENCES = (
    "A room containing toilets, sinks, and towels is called a bathroom.",
    "A room containing beds is called a bedroom.",
)


class MaskedSentence(NamedTuple):
    """Token ids of a sentence, the positions that are scored, and every position's word."""

    tokens: list[int]
    scored: list[int]
    words: list[int | None]


class _Reads(NamedTuple):
    """Distinct masked inputs, and the log probabilities to read from them."""

    inputs: list[tuple[int, ...]]
    owner: list[int]  # the sentence that each log probability belongs to
    source: list[int]  # the masked input that it is read from
    position: list[int]
    token: list[int]


class MaskedBackend:
    """Sum over a sentence's scored tokens of log p(token | all others); none of them is special.

    Raises
    ------
    ModelError
        The tokenizer has no mask token, or cannot tell words where ``whole_words`` needs them, or
        the model gives one sentence several scores.
    """

    strategy = "masked"

    def __init__(self, forward: Forward, encoder: Encoder, *, whole_words: bool) -> None:
        if encoder.tokenizer.mask_token_id is None:
            raise ModelError(f"the tokenizer of {encoder.name} has no mask token; use --model")
        if whole_words and not encoder.tokenizer.is_fast:
            raise ModelError(
                f"the tokenizer of {encoder.name} cannot tell words; use --scoring pll"
            )
        self.forward = forward
        self.encoder = encoder
        self.whole_words = whole_words
        self.fallbacks: list[str] = []
        self._batched = True
        with in_float32(forward):
            self._check()

    def encode(
        self, sentences: Sequence[str], starts: Sequence[int] | None = None
    ) -> list[MaskedSentence]:
        """Tokens of each sentence, and which of them are scored: those from its start on.

        Raises
        ------
        ModelError
            A sentence is empty, holds nothing to score, or is longer than the model's context; or
            the tokenizer cannot tell where a token begins.
        """
        first = self._first_counted(sentences, starts)
        batch = self.encoder.call(sentences, return_special_tokens_mask=True)
        encoded = []
        for row, (sentence, tokens) in enumerate(zip(sentences, batch["input_ids"], strict=True)):
            special = batch["special_tokens_mask"][row]
            ordinary = [position for position, mark in enumerate(special) if not mark]
            scored = [position for position in ordinary if position >= first[row]]
            words = batch.word_ids(row) if self.whole_words else []
            if ordinary and not scored:
                self.encoder.limits.refuse_uncounted(sentence)
            if not scored:
                raise ModelError(f"{self.encoder.name} sees no token to score in {sentence!r}")
            self.encoder.limits.check(sentence, tokens, fewest=1)
            encoded.append(MaskedSentence(tokens, scored, words))
        return encoded

    def _first_counted(self, sentences: Sequence[str], starts: Sequence[int] | None) -> list[int]:
        if starts is None:
            return [0] * len(sentences)
        return list(map(first_counted, sentences, self.encoder.offsets(sentences), starts))

    def token_counts(self, encoded: Sequence[MaskedSentence]) -> IntArray:
        """How many tokens of each sentence are masked in turn: the special ones never are."""
        return np.array([len(sentence.scored) for sentence in encoded], np.int64)

    def log_probs(self, encoded: Sequence[MaskedSentence], budget: int, meter: Meter) -> FloatArray:
        """Pseudo-log-likelihood in nats of each encoded sentence, ``[sentences]``."""
        reads = self._reads(encoded)
        scores = np.zeros(len(encoded))
        source = np.array(reads.source)
        lengths = np.array([len(tokens) for tokens in reads.inputs])
        by_input = np.argsort(source, kind="stable")
        starts = np.searchsorted(source[by_input], np.arange(len(lengths) + 1))
        for rows in batches_by_length(lengths, budget if self._batched else 1):
            wanted = np.concatenate([by_input[starts[row] : starts[row + 1]] for row in rows])
            values = self._read(reads, rows, wanted)
            np.add.at(scores, np.array(reads.owner)[wanted], values)
            meter.advance(len(rows) / len(lengths), int(lengths[rows].sum()))
        return scores

    def _check(self) -> None:
        """Batches must agree with one plain forward per masked copy; else copies run singly."""
        encoded = self.encode(CHECK_SENTENCES)
        expected = np.array([self._naive(sentence) for sentence in encoded])
        for self._batched in (True, False):
            meter = Meter()
            meter.begin(len(encoded), 0)
            if agree(self.forward, self.log_probs(encoded, 1024, meter), expected):
                return
            self.fallbacks.append("batches disagree with single masked copies")
            _log.warning("%s: %s", self.encoder.name, self.fallbacks[-1])
        raise ModelError(
            f"{self.encoder.name} does not give one score to one sentence; use another --model"
        )

    def _naive(self, sentence: MaskedSentence) -> float:
        return sum(
            self.forward.masked(list(masked), position, sentence.tokens[position])
            for position, masked in self._masked_copies(sentence)
        )

    def _read(self, reads: _Reads, rows: IntArray, wanted: IntArray) -> FloatArray:
        """Log probabilities of the ``wanted`` reads, all from the masked inputs in ``rows``."""
        width = len(reads.inputs[rows[0]])
        pad = self.encoder.tokenizer.pad_token_id or 0
        ids = np.full((len(rows), width), pad)
        present = np.zeros_like(ids)
        for line, row in enumerate(rows):
            tokens = reads.inputs[row]
            ids[line, : len(tokens)] = tokens
            present[line, : len(tokens)] = 1
        line_of = {int(row): line for line, row in enumerate(rows)}
        flat = np.array([line_of[reads.source[i]] * width + reads.position[i] for i in wanted])
        positions, asked = np.unique(flat, return_inverse=True)
        inputs = {
            "input_ids": self.forward.tensor(ids),
            "attention_mask": self.forward.tensor(present),
        }
        tokens = np.array([reads.token[i] for i in wanted])
        return self.forward.read(inputs, positions, asked, tokens)

    def _reads(self, encoded: Sequence[MaskedSentence]) -> _Reads:
        reads = _Reads([], [], [], [], [])
        known: dict[tuple[int, ...], int] = {}
        for owner, sentence in enumerate(encoded):
            for position, masked in self._masked_copies(sentence):
                if masked not in known:
                    known[masked] = len(reads.inputs)
                    reads.inputs.append(masked)
                reads.owner.append(owner)
                reads.source.append(known[masked])
                reads.position.append(position)
                reads.token.append(sentence.tokens[position])
        return reads

    def _masked_copies(self, sentence: MaskedSentence) -> Iterator[tuple[int, tuple[int, ...]]]:
        mask = self.encoder.tokenizer.mask_token_id
        for position in sentence.scored:
            masked = list(sentence.tokens)
            masked[position] = mask
            if self.whole_words and sentence.words[position] is not None:
                for later in range(position + 1, sentence.scored[-1] + 1):
                    if sentence.words[later] == sentence.words[position]:
                        masked[later] = mask
            yield position, tuple(masked)
