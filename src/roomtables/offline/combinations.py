"""Which combinations of objects get a query sentence: all of a label space, or what rooms need."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from math import comb
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import ConfigError, StoreError
from roomtables.labels import LabelSpace, normalise
from roomtables.sentences import Template
from roomtables.storage.lookup import Lookup, key_bits, unpack_ranks
from roomtables.storage.misses import FOLDER, Misses
from roomtables.storage.versions import LOOKUP, SpaceFolder

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


@dataclass(frozen=True)
class Asked:
    """Combinations by source, as numbers of objects (from 1, in label order).

    Attributes
    ----------
    by_source : ``[n, widest]``, each row ascending, 0 behind the last; rows sorted and distinct
    misses : the misses that these answer; ``None`` where misses were not read
    """

    by_source: Mapping[str, Ranks]
    misses: Misses | None = None

    @classmethod
    def read(cls, combinations: str, labels: LabelSpace, tables: Path) -> Asked:
        """What the setting ``combinations`` takes in besides all, none, or a file's rooms.

        ``misses``: what the published version holds, and the misses. A file: misses, old and new.
        ``all``: the misses are among them.
        """
        if combinations == "none":
            return cls({})
        space = SpaceFolder(tables, labels.name)
        misses = Misses.read(space.path / FOLDER)
        if combinations == "all":
            return cls({}, misses)
        questions = {(miss.source, miss.objects) for miss in misses.open}
        held: dict[str, list[Ranks]] = {}
        if combinations == "misses":
            held = _published(space, labels)
        else:
            questions |= misses.taken
        numbers = {o.label: number for number, o in enumerate(labels.objects, start=1)}
        for source, objects in questions:
            names = {labels.object_aliases.get(normalise(name)) for name in objects}
            if names and None not in names:
                row = np.array([[numbers[name] for name in names if name]], np.int64)
                held.setdefault(source, []).append(row)
        return cls({source: _distinct(parts) for source, parts in sorted(held.items())}, misses)

    def answered(self) -> None:
        """Note that a published version answers the misses that were read."""
        if self.misses is not None:
            self.misses.take_in()

    def fingerprint(self) -> list[str]:
        """What the combinations of each source are, hashed."""
        return [
            f"{source} {rows.shape} {hashlib.sha256(rows.tobytes()).hexdigest()}"
            for source, rows in self.by_source.items()
        ]

    def ranked(self, source: str, ranks: Sequence[int], k: int) -> Ranks:
        """A source's combinations as ranks ``[n, k]``, ascending, 0 behind the last.

        ``ranks`` are those of the objects, in label order.
        """
        numbers = self.by_source.get(source, np.zeros((0, k), np.int64))
        none = len(ranks) + 1
        found = np.sort(np.array([none, *ranks], np.int64)[numbers], axis=1)[:, :k]
        found = np.pad(found, ((0, 0), (0, k - found.shape[1])), constant_values=none)
        return np.where(found == none, 0, found)


def _published(space: SpaceFolder, labels: LabelSpace) -> dict[str, list[Ranks]]:
    """The combinations that are published, of objects that the label space still has."""
    version = space.published()
    if version is None:
        return {}
    try:
        lookup = Lookup.open(version.path / LOOKUP, version.manifest)
    except StoreError:  # built anew all the same
        return {}
    now = {o.label: number for number, o in enumerate(labels.objects, start=1)}
    found = {}
    for source, arrays in lookup.sources.items():
        number_of_rank = np.zeros(1 + len(lookup.objects), np.int64)
        number_of_rank[arrays.ranks] = [now.get(o.label, 0) for o in lookup.objects]
        ranks = unpack_ranks(arrays.keys, lookup.k)
        numbers = number_of_rank[ranks]
        found[source] = [numbers[((numbers > 0) == (ranks > 0)).all(axis=1)]]
    return found


def _distinct(parts: Iterable[Ranks]) -> Ranks:
    """Rows of any width as one array, each ascending with zeros last, sorted, no row twice."""
    blocks = list(parts)
    width = max(block.shape[1] for block in blocks)
    padded = [np.pad(block, ((0, 0), (0, width - block.shape[1]))) for block in blocks]
    rows = np.concatenate(padded)
    rows = np.where(rows == 0, np.iinfo(np.int64).max, rows)
    rows.sort(axis=1)
    rows = np.where(rows == np.iinfo(np.int64).max, 0, rows)
    rows = rows[np.lexsort(rows.T[::-1])]
    new = np.ones(len(rows), np.bool_)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.ascontiguousarray(rows[new])
