"""Documents to training batches: generated chunk by chunk, tokenised, and packed into rows.

Several documents share a row, but the mask keeps each from attending to another: each starts at
position 0 with its own BOS, as a sentence does when it is scored.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import torch
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors, trainers

from .answers import Posterior, Target
from .facts import Facts
from .generate import Writer, documents

BOS = "<s>"
_CHUNK_DOCUMENTS = 2_000
_TOKENIZER_DOCUMENTS = 60_000
_TOKENIZER_SEED = 1_000_003


Document = tuple[list[int], list[Target]]


@dataclass(frozen=True)
class Batch:
    """Rows of packed documents; every tensor is (rows, length), document -1 is padding.

    ``answers`` are the places, in the flattened batch, whose next token begins an answer, each
    with the tokens that may stand there and their probabilities.
    """

    ids: torch.Tensor
    positions: torch.Tensor
    document: torch.Tensor
    answers: list[Target]

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


def train_tokenizer(facts: Facts, vocabulary: int, count: int = _TOKENIZER_DOCUMENTS) -> Tokenizer:
    """Train a byte-level BPE tokenizer that puts BOS before a sentence and nothing after it."""
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
    posterior: Posterior, seed: int, rows: int, length: int, start: tuple[int, int]
) -> Iterator[tuple[Batch, tuple[int, int]]]:
    """Yield batches without end, each with the position (chunk, batch) that follows it."""
    chunk, skip = start
    while True:
        packed = _pack(_chunk(posterior, seed + chunk, length), length)
        random.Random(seed + chunk).shuffle(packed)
        whole = range(0, len(packed) - rows + 1, rows)
        for index, at in list(enumerate(whole))[skip:]:
            last = index + 1 == len(whole)
            yield (
                _tensors(packed[at : at + rows], length),
                (chunk + 1, 0) if last else (chunk, index + 1),
            )
        chunk, skip = chunk + 1, 0


def _chunk(posterior: Posterior, seed: int, length: int) -> list[Document]:
    writer = Writer(posterior.world, seed, mark=True)
    written = []
    for _ in range(_CHUNK_DOCUMENTS):
        text = writer.document()
        ids, targets = posterior.targets(text, writer.answers)
        written.append((ids[:length], [target for target in targets if target[0] < length]))
    return written


def _pack(written: list[Document], length: int) -> list[list[Document]]:
    """Pack documents into rows, the longest first, each where it fits best."""
    open_rows: list[list[list[Document]]] = [[] for _ in range(length + 1)]
    rows = []
    for document in sorted(written, key=lambda document: len(document[0]), reverse=True):
        size = len(document[0])
        left = next((left for left in range(size, length + 1) if open_rows[left]), None)
        if left is None:
            left = length
            rows.append([document])
            row = rows[-1]
        else:
            row = open_rows[left].pop()
            row.append(document)
        open_rows[left - size].append(row)
    return rows


def _tensors(rows: list[list[Document]], length: int) -> Batch:
    ids = torch.zeros(len(rows), length, dtype=torch.long)
    positions = torch.zeros_like(ids)
    numbers = torch.full_like(ids, -1)
    answers = []
    for index, row in enumerate(rows):
        at = 0
        for number, (text, targets) in enumerate(row):
            end = at + len(text)
            ids[index, at:end] = torch.tensor(text)
            positions[index, at:end] = torch.arange(len(text))
            numbers[index, at:end] = number
            start = index * length + at - 1  # a token is predicted at the one before it
            answers += [(start + place, tokens, shares) for place, tokens, shares in targets]
            at = end
    return Batch(ids, positions, numbers, answers)
