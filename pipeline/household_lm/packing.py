"""Documents to training batches: generated chunk by chunk, tokenised, packed, never mixed.

Several documents share a row, but none sees another: each starts at position 0 after its own
BOS, as a sentence does when it is scored.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import torch
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors, trainers

from .facts import Facts
from .generate import documents

BOS = "<s>"
_CHUNK_DOCUMENTS = 2_000
_TOKENIZER_DOCUMENTS = 60_000
_TOKENIZER_SEED = 1_000_003


@dataclass(frozen=True)
class Batch:
    """Rows of packed documents; every tensor is (rows, length), document -1 is padding."""

    ids: torch.Tensor
    positions: torch.Tensor
    document: torch.Tensor

    def mask(self) -> torch.Tensor:
        """Additive attention mask (rows, 1, length, length): earlier tokens of the document."""
        same = self.document[:, :, None] == self.document[:, None, :]
        seen = same & torch.ones(same.shape[1:], dtype=torch.bool).tril()
        return torch.where(seen, 0.0, torch.finfo(torch.float32).min)[:, None]

    def targets(self) -> torch.Tensor:
        """The next token of the same document, else -100."""
        next_ids = self.ids.roll(-1, 1)
        same = (self.document == self.document.roll(-1, 1)) & (self.document >= 0)
        same[:, -1] = False
        return torch.where(same, next_ids, -100)


def train_tokenizer(
    facts: Facts, vocabulary: int, count: int = _TOKENIZER_DOCUMENTS
) -> Tokenizer:
    """Train a byte-level BPE tokenizer that puts BOS, and no EOS, around a sentence."""
    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    trainer = trainers.BpeTrainer(
        vocab_size=vocabulary,
        special_tokens=[BOS],
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    texts = islice(documents(facts, _TOKENIZER_SEED), count)
    tokenizer.train_from_iterator(texts, trainer)
    tokenizer.post_processor = processors.TemplateProcessing(
        single=f"{BOS} $A", pair=f"{BOS} $A {BOS} $B", special_tokens=[(BOS, 0)]
    )
    return tokenizer


def batches(
    facts: Facts, tokenizer: Tokenizer, seed: int, rows: int, length: int, start: tuple[int, int]
) -> Iterator[tuple[Batch, tuple[int, int]]]:
    """Yield batches without end, each with the position (chunk, batch) that follows it."""
    chunk, skip = start
    while True:
        packed = _pack(_encode_chunk(facts, tokenizer, seed + chunk, length), length)
        random.Random(seed + chunk).shuffle(packed)
        whole = range(0, len(packed) - rows + 1, rows)
        for index, at in list(enumerate(whole))[skip:]:
            last = index + 1 == len(whole)
            yield (
                _tensors(packed[at : at + rows], length),
                (chunk + 1, 0) if last else (chunk, index + 1),
            )
        chunk, skip = chunk + 1, 0


def _encode_chunk(facts: Facts, tokenizer: Tokenizer, seed: int, length: int) -> list[list[int]]:
    texts = list(islice(documents(facts, seed), _CHUNK_DOCUMENTS))
    return [encoding.ids[:length] for encoding in tokenizer.encode_batch(texts)]


def _pack(encoded: list[list[int]], length: int) -> list[list[list[int]]]:
    """Pack documents into rows, the longest first, each where it fits best."""
    room_left: list[list[list[list[int]]]] = [[] for _ in range(length + 1)]
    rows = []
    for ids in sorted(encoded, key=len, reverse=True):
        fits = next((left for left in range(len(ids), length + 1) if room_left[left]), None)
        if fits is None:
            rows.append([ids])
            room_left[length - len(ids)].append(rows[-1])
        else:
            row = room_left[fits].pop()
            row.append(ids)
            room_left[fits - len(ids)].append(row)
    return rows


def _tensors(rows: list[list[list[int]]], length: int) -> Batch:
    ids = torch.zeros(len(rows), length, dtype=torch.long)
    positions = torch.zeros_like(ids)
    document = torch.full_like(ids, -1)
    for index, row in enumerate(rows):
        at = 0
        for number, tokens in enumerate(row):
            ids[index, at : at + len(tokens)] = torch.tensor(tokens)
            positions[index, at : at + len(tokens)] = torch.arange(len(tokens))
            document[index, at : at + len(tokens)] = number
            at += len(tokens)
    return Batch(ids, positions, document)
