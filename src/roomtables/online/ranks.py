"""Objects as ranks: where a combination's scores stand, and the objects of many rooms at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, chain
from math import comb

import numpy as np
from numpy.typing import NDArray

from roomtables.online.names import UNLISTED, Vocabulary
from roomtables.storage.lookup import SourceArrays, key_bits, pack_keys

ABSENT = -1
_PART = 1 << 13  # rooms worked on at once: their arrays fit the processor's cache
_NO_RANK = np.iinfo(np.int64).max


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


@dataclass(frozen=True)
class RankedRooms:
    """The ranks of rooms' objects, as named: in any order, repeated, and ``UNLISTED``.

    Attributes
    ----------
    ranks : ``[objects of all rooms]``, room by room
    lengths : ``[rooms]``, how many objects each room has
    """

    ranks: NDArray[np.int64]
    lengths: NDArray[np.intp]

    @classmethod
    def of(cls, rooms: Sequence[Sequence[str]], vocabulary: Vocabulary) -> RankedRooms:
        """The ranks of the objects that rooms name."""
        lengths = np.fromiter(map(len, rooms), np.intp, len(rooms))
        ranks = map(vocabulary.__getitem__, chain.from_iterable(rooms))
        return cls(np.fromiter(ranks, np.int64, int(lengths.sum())), lengths)

    @cached_property
    def _ends(self) -> NDArray[np.intp]:
        ends: NDArray[np.intp] = np.cumsum(self.lengths)
        return ends

    def listed(self, room: int) -> list[int]:
        """The ranks of a room's listed objects, ascending, once each."""
        end = int(self._ends[room])
        return sorted({*self.ranks[end - int(self.lengths[room]) : end].tolist()} - {UNLISTED})

    def only(self, rooms: NDArray[np.int64]) -> RankedRooms:
        """Some of the rooms, by number, ascending."""
        chosen = np.zeros(len(self.lengths), bool)
        chosen[rooms] = True
        return RankedRooms(self.ranks[np.repeat(chosen, self.lengths)], self.lengths[rooms])

    def with_unlisted(self) -> list[int]:
        """The rooms that have an object which no table lists."""
        places = np.flatnonzero(self.ranks == UNLISTED)
        return list(dict.fromkeys(np.searchsorted(self._ends, places, side="right").tolist()))

    def parts(self) -> Iterator[tuple[slice, RankedRooms]]:
        """The rooms in parts of bounded size, and where each part stands among them."""
        for start in range(0, len(self.lengths), _PART):
            rooms = slice(start, start + _PART)
            lengths = self.lengths[rooms]
            first = int(self._ends[start] - lengths[0])
            yield rooms, RankedRooms(self.ranks[first : first + int(lengths.sum())], lengths)

    def most_informative(self, k: int) -> NDArray[np.int64]:
        """Each room's ``k`` least distinct ranks, ascending, ``[rooms, k]``; 0 behind the last."""
        picked = np.zeros((len(self.lengths), k), np.int64)
        occupied = np.flatnonzero(self.lengths)  # reduceat gives an empty group its neighbour's
        if len(occupied) == 0:
            return picked
        sizes = self.lengths[occupied]
        starts = np.cumsum(sizes) - sizes
        left = np.where(self.ranks == UNLISTED, _NO_RANK, self.ranks)
        for place in range(k):
            least = np.minimum.reduceat(left, starts)
            picked[occupied, place] = np.where(least == _NO_RANK, 0, least)
            if place < k - 1:
                left[left == np.repeat(least, sizes)] = _NO_RANK
        return picked

    def summed(
        self, evidence: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """The evidence of each room's distinct listed objects, added most informative first.

        ``evidence`` is ``[1 + rank, candidates]``. Returns the sums ``[rooms, candidates]``, and
        for each room whether there was anything to add.
        """
        rooms, objects = self._distinct(len(evidence))
        counts = np.bincount(rooms, minlength=len(self.lengths))
        starts = np.cumsum(counts) - counts
        by_size = np.argsort(-counts, kind="stable")
        sizes = counts[by_size]
        total = np.zeros((len(self.lengths), evidence.shape[1]))
        # Object by object, so that a sum is the very one that a room alone has.
        for place in range(int(counts.max(initial=0))):
            having = by_size[: int(np.searchsorted(-sizes, -place, side="left"))]
            total[having] += evidence[objects[starts[having] + place]]
        return total, counts > 0

    def _distinct(self, span: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Room and rank of the listed objects, once each, sorted; ``span`` is above every rank."""
        rooms = np.repeat(np.arange(len(self.lengths)), self.lengths)
        sorted_ = np.sort(rooms * span + self.ranks)
        distinct = sorted_[np.flatnonzero(np.diff(sorted_, prepend=-1))]
        distinct = distinct[distinct % span != UNLISTED]
        return distinct // span, distinct % span
