"""Combinations that a build owes to questions: the misses, and what is published already."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace, normalise
from roomtables.misses import FOLDER, Misses
from roomtables.offline.combinations import Ranks
from roomtables.store import LOOKUP, SpaceFolder
from roomtables.twin import Twin, unpack_ranks


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
        twin = Twin.open(version.path / LOOKUP, version.manifest)
    except StoreError:  # built anew all the same
        return {}
    now = {o.label: number for number, o in enumerate(labels.objects, start=1)}
    found = {}
    for source, arrays in twin.sources.items():
        number_of_rank = np.zeros(1 + len(twin.objects), np.int64)
        number_of_rank[arrays.ranks] = [now.get(o.label, 0) for o in twin.objects]
        ranks = unpack_ranks(arrays.keys, twin.k)
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
