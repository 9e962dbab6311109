"""Find the scores of a combination: its place in the sorted keys, computed or searched for."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

from roomtables.twin import SourceArrays, key_bits, pack_keys

ABSENT = -1


class ScoreRows:
    """The rows of one source's query scores over the candidate rooms.

    Where a table holds every combination, a combination's row follows from its ranks by arithmetic
    (it is still compared with the key there); otherwise a binary search finds it.

    Parameters
    ----------
    arrays : the source's arrays
    k : objects in a combination at most
    columns : the candidates' columns of the scores; ``None`` for all of them
    """

    def __init__(self, arrays: SourceArrays, k: int, columns: NDArray[np.intp] | None) -> None:
        self._keys = arrays.keys
        self._scores = arrays.scores
        self._maxima = arrays.maxima
        self._columns = columns
        self._k = k
        self._shifts = tuple(key_bits(k) * (k - 1 - place) for place in range(k))
        self._before = _rows_before(len(arrays.ranks), k, len(arrays.keys))
        self._before_lists = [row.tolist() for row in self._before]

    def find(self, ranks: Sequence[int]) -> int:
        """The row of a combination, its ranks ascending; ``ABSENT`` if the table lacks it."""
        key = 0
        for shift, rank in zip(self._shifts, ranks, strict=False):
            key |= rank << shift
        keys = self._keys
        if self._before_lists:
            row, previous = -1, 0
            for before, rank in zip(self._before_lists, ranks, strict=False):
                row += 1 + before[rank - 1] - before[previous]
                previous = rank
        else:
            # A Python int would turn all keys to float64, slowly and wrongly.
            row = int(keys.searchsorted(np.uint64(key)))
            if row == len(keys):
                return ABSENT
        return row if int(keys[row]) == key else ABSENT

    def find_many(self, ranks: NDArray[np.int64]) -> NDArray[np.int64]:
        """The rows of combinations ``[n, k]``, 0 behind the last rank → ``[n]``."""
        wanted = pack_keys(ranks, self._k)
        if len(self._keys) == 0:
            return np.full(len(ranks), ABSENT)
        if self._before_lists:
            rows = np.full(len(ranks), -1)
            previous = np.zeros(len(ranks), np.int64)
            for before, rank in zip(self._before, ranks.T, strict=True):
                step = 1 + before[np.maximum(rank, 1) - 1] - before[previous]
                rows += np.where(rank > 0, step, 0)
                previous = rank
            rows = np.maximum(rows, 0)
        else:
            rows = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        return np.where(self._keys[rows] == wanted, rows, ABSENT)

    def scores(self, row: int) -> NDArray[np.floating]:
        """S over the candidates, ``[candidates]``, nats."""
        scores: NDArray[np.floating] = self._scores[row]
        if self._maxima is not None:
            scores = scores.astype(np.float64) + self._maxima[row]
        return scores if self._columns is None else scores[self._columns]

    def scores_many(self, rows: NDArray[np.int64]) -> NDArray[np.floating]:
        """S over the candidates, ``[n, candidates]``, nats."""
        scores: NDArray[np.floating] = self._scores[rows]
        if self._maxima is not None:
            scores = scores + self._maxima[rows, np.newaxis].astype(np.float64)
        return scores if self._columns is None else scores[:, self._columns]


def _rows_before(objects: int, k: int, rows: int) -> NDArray[np.int64]:
    """How many combinations begin with one of the first ``r`` objects at a place, ``[k, 1 + r]``.

    Sorted by key, a combination stands before those it begins. So below a prefix, each object
    passed over accounts for itself and all that it begins. Empty where a combination is missing.
    """
    complete = sum(comb(objects, size) for size in range(1, k + 1))
    if rows != complete:
        return np.zeros((0, 0), np.int64)
    begun = [
        [
            sum(comb(objects - rank, size) for size in range(k - place))
            for rank in range(1, objects + 1)
        ]
        for place in range(k)
    ]
    return np.array([[0, *np.cumsum(row).tolist()] for row in begun], np.int64)
