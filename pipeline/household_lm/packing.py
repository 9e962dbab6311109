"""Documents to training batches: generated chunk by chunk, tokenised, and packed into rows.

Several documents share a row, but the mask keeps each from attending to another: each starts at
position 0 with its own BOS, as a sentence does when it is scored.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
import torch
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors, trainers

from . import english
from .answers import Document, Floats, Posterior, Target
from .facts import Facts
from .generate import Writer, documents

BOS = "<s>"
_CHUNK_DOCUMENTS = 2_000
_TOKENIZER_DOCUMENTS = 60_000
_TOKENIZER_SEED = 1_000_003
_TOKENIZER_NAMES = 10


@dataclass(frozen=True)
class Batch:
    """Rows of packed documents; every tensor is (rows, length), document -1 is padding.

    ``answers`` are what tokens of the flattened batch may be. ``rooms`` and ``objects`` are places
    before a token whose text has told objects, or a room, and what might be named there next:
    (places,) and (places, first tokens).
    """

    ids: torch.Tensor
    positions: torch.Tensor
    document: torch.Tensor
    answers: list[Target]
    rooms: tuple[torch.Tensor, torch.Tensor]
    objects: tuple[torch.Tensor, torch.Tensor]

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
    texts = islice(documents(facts, _TOKENIZER_SEED, noisy=0.0), count)
    tokenizer.train_from_iterator(chain(texts, _names(facts)), trainer)
    tokenizer.post_processor = processors.TemplateProcessing(
        single=f"{BOS} $A", pair=f"{BOS} $A {BOS} $B", special_tokens=[(BOS, 0)]
    )
    return tokenizer


def _names(facts: Facts) -> Iterator[str]:
    """Every object's and room's name, so often that few are cut into pieces."""
    called = {name for thing in facts.things.values() for name, _ in thing.called()}
    rooms = {name for room in facts.rooms.values() for name in (room.name, *room.synonyms)}
    for name in sorted(called | rooms):
        for form in (name, english.plural(name)):
            yield from [f"the {form}"] * _TOKENIZER_NAMES


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
    return [
        posterior.document(writer.document(), writer.marks).cut(length)
        for _ in range(_CHUNK_DOCUMENTS)
    ]


def _pack(written: list[Document], length: int) -> list[list[Document]]:
    """Pack documents into rows, the longest first, each where it fits best."""
    open_rows: list[list[list[Document]]] = [[] for _ in range(length + 1)]
    rows = []
    for document in sorted(written, key=lambda document: len(document.ids), reverse=True):
        size = len(document.ids)
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
    answers: list[Target] = []
    rooms: dict[int, Floats] = {}
    objects: dict[int, Floats] = {}
    for index, row in enumerate(rows):
        at = 0
        for number, document in enumerate(row):
            end = at + len(document.ids)
            ids[index, at:end] = torch.tensor(document.ids)
            positions[index, at:end] = torch.arange(len(document.ids))
            numbers[index, at:end] = number
            start = index * length + at
            answers += [replace(target, place=start + target.place) for target in document.answers]
            rooms |= {start + place: shares for place, shares in document.rooms.items()}
            objects |= {start + place: shares for place, shares in document.objects.items()}
            at = end
    return Batch(ids, positions, numbers, answers, _stacked(rooms), _stacked(objects))


def _stacked(known: dict[int, Floats]) -> tuple[torch.Tensor, torch.Tensor]:
    """Places before tokens, and a row of probabilities of each."""
    shares = np.stack([*known.values()]) if known else np.zeros((0, 0), np.float32)
    return torch.tensor([*known], dtype=torch.long) - 1, torch.from_numpy(shares)
