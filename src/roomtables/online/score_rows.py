"""Where a combination's scores stand in the mapped arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from math import comb

import numpy as np
from numpy.typing import NDArray

from roomtables.storage.lookup import SourceArrays, key_bits, pack_keys

ABSENT = -1


class ScoreRows:
    """The rows of one source's query scores, over the candidate rooms.

    Where the tables hold every combination, a combination's row follows from its ranks by
    arithmetic; otherwise a binary search finds it. Either way the key in the row is compared. The
    arithmetic saves the search its misses of the processor's cache: in 1.4 million combinations a
    room took 14.0 µs instead of 16.7 µs by rule ``query`` (``tests/benchmarks/lookup.py``).

    Parameters
    ----------
    arrays : the source's arrays
    k : objects in a combination at most
    columns : the candidates' columns of the scores; ``None`` for all of them
    """

    def __init__(self, arrays: SourceArrays, k: int, columns: NDArray[np.intp] | None) -> None:
        self._keys = arrays.keys
        self._scores = arrays.scores
        self._columns = columns
        self._k = k
        self._shifts = tuple(key_bits(k) * (k - 1 - place) for place in range(k))
        self._begun = _begun_before(len(arrays.ranks), k, len(arrays.keys))
        self._begun_arrays = [np.array(counts, np.int64) for counts in self._begun]

    def find(self, ranks: Sequence[int]) -> int:
        """The row of the first ``k`` of these ranks, ascending; ``ABSENT`` if there is none."""
        key = 0
        for shift, rank in zip(self._shifts, ranks, strict=False):
            key |= rank << shift
        keys = self._keys
        if self._begun:
            row, previous = -1, 0
            for begun, rank in zip(self._begun, ranks, strict=False):
                row += 1 + begun[rank - 1] - begun[previous]
                previous = rank
        else:
            # A Python int would turn all keys to float64, slowly and wrongly.
            row = int(keys.searchsorted(np.uint64(key)))
            if row == len(keys):
                return ABSENT
        return row if int(keys[row]) == key else ABSENT

    def find_many(self, ranks: NDArray[np.int64]) -> NDArray[np.int64]:
        """The rows of combinations ``[n, k]``, 0 behind the last rank → ``[n]``."""
        keys = pack_keys(ranks, self._k)
        if len(self._keys) == 0:
            return np.full(len(ranks), ABSENT)
        if self._begun:
            rows = np.full(len(ranks), -1)
            previous = np.zeros(len(ranks), np.int64)
            for begun, rank in zip(self._begun_arrays, ranks.T, strict=True):
                step = 1 + begun[np.maximum(rank, 1) - 1] - begun[previous]
                rows += np.where(rank > 0, step, 0)
                previous = rank
            rows = np.maximum(rows, 0)
        else:
            rows = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return np.where(self._keys[rows] == keys, rows, ABSENT)

    def scores(self, row: int) -> NDArray[np.floating]:
        """S of the query sentence for each candidate, ``[candidates]``, nats."""
        scores: NDArray[np.floating] = self._scores[row]
        return scores if self._columns is None else scores[self._columns]

    def scores_many(self, rows: NDArray[np.int64]) -> NDArray[np.floating]:
        """S of the query sentences for each candidate, ``[n, candidates]``, nats."""
        scores: NDArray[np.floating] = self._scores[rows]
        return scores if self._columns is None else scores[:, self._columns]


def _begun_before(objects: int, k: int, rows: int) -> list[list[int]]:
    """How many combinations begin with one of the first ``r`` objects at a place, ``[k, 1 + r]``.

    Sorted by key, a combination stands right before those that begin with it. So behind the same
    first objects, each object passed over accounts for itself and for all that it begins. Empty
    where the tables lack a combination.
    """
    if rows != sum(comb(objects, size) for size in range(1, k + 1)):
        return []
    return [
        [0, *accumulate(_begun_by(objects - rank, k - place) for rank in range(1, objects + 1))]
        for place in range(k)
    ]


def _begun_by(following: int, places: int) -> int:
    """How many combinations begin with an object: it alone, or with some of those behind it."""
    return sum(comb(following, size) for size in range(places))
