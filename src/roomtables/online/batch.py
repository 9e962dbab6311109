"""Arithmetic on the ranks of many rooms' objects at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from math import comb

import numpy as np
from numpy.typing import NDArray

from roomtables.online.names import UNLISTED, Vocabulary
from roomtables.storage.lookup import SourceArrays, key_bits, pack_keys

_NO_RANK = np.iinfo(np.int64).max


def ranks_of(
    rooms: Sequence[Sequence[str]], vocabulary: Vocabulary
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """The ranks of all rooms' objects, end to end, and how many objects each room has."""
    lengths = np.fromiter(map(len, rooms), np.intp, len(rooms))
    flat = map(vocabulary.__getitem__, chain.from_iterable(rooms))
    return np.fromiter(flat, np.int64, int(lengths.sum())), lengths


def most_informative(
    ranks: NDArray[np.int64], lengths: NDArray[np.intp], k: int
) -> NDArray[np.int64]:
    """The ``k`` least distinct ranks of each room, ascending, ``[rooms, k]``; 0 behind the last."""
    picked = np.zeros((len(lengths), k), np.int64)
    some = np.flatnonzero(lengths)  # reduceat gives an empty group its neighbour's value
    if len(some) == 0:
        return picked
    sizes = lengths[some]
    starts = np.cumsum(sizes) - sizes
    left = np.where(ranks == UNLISTED, _NO_RANK, ranks)
    for place in range(k):
        least = np.minimum.reduceat(left, starts)
        picked[some, place] = np.where(least == _NO_RANK, 0, least)
        if place < k - 1:
            left[left == np.repeat(least, sizes)] = _NO_RANK
    return picked


def summed(
    evidence: NDArray[np.float64], ranks: NDArray[np.int64], lengths: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The evidence of each room's distinct objects, added most informative first.

    Parameters
    ----------
    evidence : ``[1 + rank, candidates]``
    ranks, lengths : as from :func:`ranks_of`

    Returns
    -------
    sums : ``[rooms, candidates]``
    some : ``[rooms]``, whether there was anything to add
    """
    total = np.zeros((len(lengths), evidence.shape[1]))
    span = len(evidence)
    keyed = np.sort(np.repeat(np.arange(len(lengths)), lengths) * span + ranks)
    distinct = keyed[np.flatnonzero(np.diff(keyed, prepend=-1))]
    distinct = distinct[distinct % span != UNLISTED]
    rooms, objects = distinct // span, distinct % span
    counts = np.bincount(rooms, minlength=len(lengths))
    starts = np.cumsum(counts) - counts
    by_size = np.argsort(-counts, kind="stable")
    sizes = counts[by_size]
    # Column by column, so that sums are taken in the order in which one room's are.
    for place in range(int(counts.max(initial=0))):
        having = by_size[: int(np.searchsorted(-sizes, -place, side="left"))]
        total[having] += evidence[objects[starts[having] + place]]
    return total, counts > 0


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
        return scores if self._columns is None else scores[self._columns]

    def scores_many(self, rows: NDArray[np.int64]) -> NDArray[np.floating]:
        """S over the candidates, ``[n, candidates]``, nats."""
        scores: NDArray[np.floating] = self._scores[rows]
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
