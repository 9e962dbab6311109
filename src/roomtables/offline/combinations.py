"""Which combinations of objects get a query sentence: all of a label space, or what rooms need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import ConfigError
from roomtables.labels import LabelSpace, normalise
from roomtables.sentences import Template
from roomtables.twin import key_bits

Ranks = NDArray[np.int64]


def check_key_size(objects: int, k: int) -> None:
    """Refuse label spaces whose combinations do not fit a 64-bit key.

    Raises
    ------
    ConfigError
        There are more objects than a rank in a key of ``k`` can count.
    """
    if objects >= 1 << key_bits(k):
        raise ConfigError(
            f"{objects} objects are too many for combinations of {k}; choose a smaller -k"
        )


def count_all(objects: int, k: int) -> int:
    """How many combinations of 1 to ``k`` objects there are (7,175 for 35 objects and k = 3)."""
    return sum(comb(objects, size) for size in range(1, k + 1))


def all_combinations(objects: int, k: int) -> Ranks:
    """Every combination of 1 to ``k`` ranks, ``[n, k]``, ascending, 0 behind the last."""
    blocks = []
    for size in range(1, min(k, objects) + 1):
        block = np.zeros((comb(objects, size), k), np.int64)
        flat = chain.from_iterable(combinations(range(1, objects + 1), size))
        block[:, :size] = np.fromiter(flat, np.int64, block.shape[0] * size).reshape(-1, size)
        blocks.append(block)
    return np.concatenate(blocks)


def combinations_of_rooms(
    rooms: Iterable[Sequence[str]], labels: LabelSpace, ranks: Mapping[str, int], k: int
) -> Ranks:
    """The combinations that rooms need: the ``k`` best ranks among each room's known objects."""
    needed = set()
    for objects in rooms:
        names = {labels.object_aliases.get(normalise(name)) for name in objects}
        known = sorted(ranks[name] for name in names if name is not None)
        if known:
            needed.add((*known[:k], *(0,) * (k - len(known))))
    return np.array(sorted(needed), np.int64).reshape(-1, k)


def query_frames(
    ranks: Ranks, by_rank: Sequence[str], labels: LabelSpace, template: Template
) -> Iterator[tuple[list[str], str, str]]:
    """Per combination: object labels in sentence order, and the sentence around its room."""
    by_label = {label.label: label for label in labels.objects}
    in_order = [by_label[name] for name in by_rank]
    for row in ranks.tolist():
        chosen = [in_order[rank - 1] for rank in row if rank]
        yield [o.label for o in chosen], *template.around_room(chosen)
