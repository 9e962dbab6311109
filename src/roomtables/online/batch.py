"""Arithmetic on the ranks of many rooms' objects at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from roomtables.online.vocabulary import UNLISTED, Vocabulary

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
