"""Token sequences as one sorted matrix: what every strategy works on. Knows no tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Sequences:
    """Distinct token sequences in lexicographic order, so that shared prefixes lie together.

    ``matrix`` has shape (sequences, longest), -1 beyond each of ``lengths``.
    """

    matrix: IntArray
    lengths: IntArray

    def __len__(self) -> int:
        return len(self.matrix)

    def row(self, index: int) -> list[int]:
        tokens: list[int] = self.matrix[index, : self.lengths[index]].tolist()
        return tokens

    def take(self, chosen: npt.NDArray[np.bool_]) -> Sequences:
        """The chosen sequences, still sorted, no wider than they need."""
        lengths = self.lengths[chosen]
        return Sequences(self.matrix[chosen, : lengths.max(initial=0)], lengths)


def sort_sequences(encoded: Sequence[Sequence[int]]) -> tuple[Sequences, IntArray]:
    """Sorted distinct sequences, and for each one given its index among them."""
    lengths = np.fromiter(map(len, encoded), np.int64, len(encoded))
    flat = np.fromiter((token for tokens in encoded for token in tokens), np.int64, lengths.sum())
    matrix = np.full((len(encoded), lengths.max(initial=0)), -1, np.int64)
    matrix[np.arange(matrix.shape[1]) < lengths[:, None]] = flat
    order = np.lexsort(matrix.T[::-1])
    ordered = matrix[order]
    first = np.ones(len(order), bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    index = np.empty(len(order), np.int64)
    index[order] = np.cumsum(first) - 1
    return Sequences(ordered[first], lengths[order][first]), index
