"""The objects of many rooms at once, as ranks in one array."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from roomtables.online.names import UNLISTED, Vocabulary

_PART = 1 << 13  # rooms worked on at once: their arrays fit the processor's cache
_NO_RANK = np.iinfo(np.int64).max


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
