"""Token sequences sorted, and the batches of them that a model without a packed mask can run.

Padded batches hold sequences of similar length. Groups are consecutive sequences with a common
prefix, for models with a key-value cache.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from roomtables.packing.tokens import IntArray, TokenLists

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Sequences:
    """Distinct token sequences in lexicographic order, so that shared prefixes lie together.

    ``matrix`` has shape (sequences, longest), -1 beyond each of ``lengths``. ``first`` is the first
    token of each that is scored, 1 or more; sequences that differ in nothing else are distinct.
    """

    matrix: IntArray
    lengths: IntArray
    first: IntArray

    def __len__(self) -> int:
        return len(self.matrix)

    def row(self, index: int) -> list[int]:
        """The tokens of one sequence, without padding."""
        tokens: list[int] = self.matrix[index, : self.lengths[index]].tolist()
        return tokens

    def take(self, chosen: npt.NDArray[np.bool_]) -> Sequences:
        """The chosen sequences, still sorted, no wider than they need."""
        lengths = self.lengths[chosen]
        return Sequences(self.matrix[chosen, : lengths.max(initial=0)], lengths, self.first[chosen])


def sort_sequences(
    encoded: Iterable[Sequence[int]], first: IntArray | None = None
) -> tuple[Sequences, IntArray]:
    """Sorted distinct sequences, and for each one given its index among them, ``[given]``.

    ``first`` is the first token of each that is scored; ``None``: the second token.
    """
    tokens = TokenLists.of(encoded)
    lengths = tokens.lengths
    first = np.ones(len(tokens), np.int64) if first is None else first
    matrix = np.full((len(tokens), lengths.max(initial=0)), -1, np.int64)
    matrix[np.arange(matrix.shape[1]) < lengths[:, None]] = tokens.flat
    order = np.lexsort((first, *matrix.T[::-1]))
    ordered, ordered_first = matrix[order], first[order]
    new = np.ones(len(order), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1) | (ordered_first[1:] != ordered_first[:-1])
    index = np.empty(len(order), np.int64)
    index[order] = np.cumsum(new) - 1
    return Sequences(ordered[new], lengths[order][new], ordered_first[new]), index


@dataclass(frozen=True)
class PaddedBatch:
    """Sequences of similar length, padded on the right, and what to read from them.

    ``token`` and ``present`` have shape (sequences, longest - 1): the last token is read, not run.
    """

    rows: IntArray
    """The sequences of the batch, indices into all."""
    token: IntArray
    """Token ids, 0 where there is none."""
    present: npt.NDArray[np.bool_]
    """Where there is a token."""
    positions: IntArray
    """Flat indices of the positions that are read, ascending."""
    line: IntArray
    """The line of each position."""
    target: IntArray
    """The token whose log probability is read at each position."""


def padded_batches(sequences: Sequences, budget: int) -> Iterator[PaddedBatch]:
    """Batches of at most ``budget`` padded tokens, the longest sequences first."""
    for rows in batches_by_length(sequences.lengths, budget):
        width = int(sequences.lengths[rows].max()) - 1
        matrix = sequences.matrix[rows, : width + 1]
        present = matrix >= 0
        columns = np.arange(1, width + 1)
        line, column = np.nonzero(present[:, 1:] & (columns >= sequences.first[rows, None]))
        yield PaddedBatch(
            rows=rows,
            token=np.where(present, matrix, 0)[:, :width],
            present=present[:, :width],
            positions=line * width + column,
            line=line,
            target=matrix[line, column + 1],
        )


def batches_by_length(lengths: IntArray, budget: int) -> Iterator[IntArray]:
    """Indices of sequences, longest first, in batches of at most ``budget`` padded tokens."""
    order = np.argsort(-lengths, kind="stable")
    start = 0
    while start < len(order):
        rows = max(1, budget // int(lengths[order[start]]))
        yield order[start : start + rows]
        start += rows


@dataclass(frozen=True)
class Group:
    """Sequences ``start`` to ``stop``, whose first ``prefix`` tokens are the same."""

    start: int
    stop: int
    prefix: int

    @property
    def rows(self) -> slice:
        """The group's sequences as a slice of the sorted ones."""
        return slice(self.start, self.stop)


# What one more pair of forward passes costs, in tokens: merging groups saves it.
_CALL_TOKENS = 8


def group_by_prefix(sequences: Sequences, budget: int) -> Iterator[Group]:
    """Consecutive sequences with a common prefix, merged while that runs fewer tokens.

    A prefix is shorter than its sequences by at least one token. A group's continuations,
    prefix included, fill at most ``budget`` tokens.
    """
    lengths = sequences.lengths.tolist()
    common = _common_prefixes(sequences)
    start, prefix, longest = 0, lengths[0] - 1, lengths[0]
    for index in range(1, len(lengths)):
        size = index - start
        merged = min(prefix, common[index], lengths[index] - 1)
        extra = (prefix - merged) * (size - 1) + lengths[index] - merged
        longer = max(longest, lengths[index])
        if extra <= lengths[index] + _CALL_TOKENS and (size + 1) * longer <= budget:
            prefix, longest = merged, longer
            continue
        yield Group(start, index, prefix)
        start, prefix, longest = index, lengths[index] - 1, lengths[index]
    yield Group(start, len(lengths), prefix)


def _common_prefixes(sequences: Sequences) -> list[int]:
    """Length of the prefix that each sequence shares with the one before it."""
    same = np.logical_and.accumulate(sequences.matrix[1:] == sequences.matrix[:-1], axis=1)
    within = np.minimum(same.sum(axis=1), sequences.lengths[1:])
    common: list[int] = [0, *within.tolist()]
    return common
