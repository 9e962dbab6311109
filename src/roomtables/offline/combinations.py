"""Which combinations of objects get a query sentence: all, or those that were asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, combinations
from math import comb
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roomtables.config import ALL, AUTO, MISSES, NONE
from roomtables.errors import ConfigError
from roomtables.labels import LabelSpace, ObjectLabel
from roomtables.names import NameReader
from roomtables.rooms import read_room_lines
from roomtables.sentences import Template
from roomtables.storage.files import refuse_outside
from roomtables.storage.lookup import key_bits, pack_keys
from roomtables.storage.manifest import count_combinations
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from roomtables.storage.versions import SpaceFolder

Ranks = NDArray[np.int64]

# Query sentences, over all sources, up to which `auto` asks for all combinations.
MOST_SENTENCES = 2_000_000


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


def resolve(combinations: str, labels: LabelSpace, k: int, sources: int) -> str:
    """The setting, where ``auto`` becomes ``all`` or, of too many sentences, ``misses``."""
    if combinations != AUTO:
        return combinations
    sentences = count_combinations(len(labels.objects), k) * len(labels.predicted_rooms) * sources
    return ALL if sentences <= MOST_SENTENCES else MISSES


def all_combinations(objects: int, k: int) -> Ranks:
    """Every combination of 1 to ``k`` ranks, ``[n, k]``, ascending, 0 behind the last."""
    blocks = []
    for size in range(1, min(k, objects) + 1):
        block = np.zeros((comb(objects, size), k), np.int64)
        flat = chain.from_iterable(combinations(range(1, objects + 1), size))
        block[:, :size] = np.fromiter(flat, np.int64, block.shape[0] * size).reshape(-1, size)
        blocks.append(block)
    return np.concatenate(blocks)


@dataclass(frozen=True)
class Asked:
    """Combinations that were asked for, where the settings do not want all of them.

    Attributes
    ----------
    rooms : the known objects of each room of a file, as numbers (from 1, in label order)
    by_source : per source, the combinations of misses, and those that are published already, as
        numbers ``[n, widest]``: each row ascending, 0 behind the last; rows sorted and distinct
    misses : the misses that were read; ``None`` where they were not
    known : every name of an object of the label space, normalised
    new : per source, how many of ``by_source`` are not published; empty where that was not looked
        for
    """

    rooms: tuple[tuple[int, ...], ...] = ()
    by_source: Mapping[str, Ranks] = field(default_factory=dict)
    misses: Misses | None = None
    known: frozenset[str] = frozenset()
    new: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def by_file(cls, combinations: str, labels: LabelSpace) -> Asked:
        """What the rooms of the setting's file need; nothing where the setting names no file.

        Raises
        ------
        InputError
            The file cannot be read, or is malformed.
        """
        if combinations in {ALL, NONE, MISSES}:
            return cls()
        numbers, reader = _numbers(labels), NameReader(labels.object_names)
        rooms = {
            tuple(sorted({numbers[name] for name in _labels(room.objects, reader)}))
            for room in read_room_lines(Path(combinations))
        }
        return cls(tuple(sorted(rooms - {()})))

    def and_by_misses(self, combinations: str, labels: LabelSpace, tables: Path) -> Asked:
        """These, and what misses and published tables under ``tables`` ask for.

        ``misses``: what is published already, and the misses that no build has taken in. A file:
        all misses, taken in or not. ``all``: the misses are among them. ``none``: none.
        """
        if combinations == NONE:
            return self
        space = SpaceFolder(tables, labels.name)
        misses = Misses.read(space.path / FOLDER)
        if combinations == ALL:
            return replace(self, misses=misses, known=frozenset(labels.object_aliases))
        questions = {(miss.source, miss.objects) for miss in misses.open}
        published: dict[str, Ranks] = {}
        if combinations == MISSES:
            published = _published(space, labels)
        else:
            questions |= misses.taken
        found = {source: [rows] for source, rows in published.items()}
        numbers, reader = _numbers(labels), NameReader(labels.object_names)
        for source, objects in questions:
            known = _labels(objects, reader)
            if known and len(known) == len(objects):
                row = np.array([[numbers[label] for label in sorted(set(known))]], np.int64)
                found.setdefault(source, []).append(row)
        by_source = {source: _distinct(parts) for source, parts in sorted(found.items())}
        names = frozenset(labels.object_aliases)
        new = {
            source: len(rows) - len(published.get(source, ()))
            for source, rows in by_source.items()
            if combinations == MISSES
        }
        return replace(self, by_source=by_source, misses=misses, known=names, new=new)

    def take_in_misses(self) -> None:
        """Note that a published version holds the misses that were read."""
        if self.misses is not None:
            self.misses.take_in(self.known)

    def sizes(self, source: str) -> NDArray[np.int64]:
        """Of each combination of a source, how many objects it has; each combination once."""
        rows = [block for block in self._of(source) if len(block)]
        return np.count_nonzero(_distinct(rows), axis=1) if rows else np.zeros(0, np.int64)

    def recorded(self) -> list[str]:
        """What was asked for, hashed: for the record of a build's inputs."""
        rooms = hashlib.sha256(repr(self.rooms).encode()).hexdigest()
        return [f"rooms {len(self.rooms)} {rooms}"] + [
            f"{source} {rows.shape} {hashlib.sha256(rows.tobytes()).hexdigest()}"
            for source, rows in self.by_source.items()
        ]

    def ranked(self, source: str, ranks: Sequence[int], k: int) -> Ranks:
        """A source's combinations as ranks ``[n, k]``, ascending, 0 behind the last.

        ``ranks`` are those of the objects, in label order. Of more than ``k`` objects those of
        least rank count; rows are distinct and sorted by key.
        """
        none = len(ranks) + 1
        rank_of = np.array([none, *ranks], np.int64)
        parts = [np.zeros((0, k), np.int64)]
        for numbers in self._of(source):
            found = np.sort(rank_of[numbers], axis=1)[:, :k]
            found = np.pad(found, ((0, 0), (0, k - found.shape[1])), constant_values=none)
            parts.append(np.where(found == none, 0, found))
        needed = np.concatenate(parts)
        _, first = np.unique(pack_keys(needed, k), return_index=True)
        return needed[first]

    def _of(self, source: str) -> list[Ranks]:
        """What a source is asked for, by rooms and by misses."""
        by_source = [self.by_source[source]] if source in self.by_source else []
        return [_padded(self.rooms), *by_source]


def query_frames(
    ranks: Ranks, by_rank: Sequence[ObjectLabel], template: Template
) -> Iterator[tuple[list[str], str, str]]:
    """Per combination: object labels in sentence order, and the sentence around its room."""
    for row in ranks.tolist():
        chosen = [by_rank[rank - 1] for rank in row if rank]
        yield [o.label for o in chosen], *template.around_room(chosen)


def _numbers(labels: LabelSpace) -> dict[str, int]:
    return {o.label: number for number, o in enumerate(labels.objects, start=1)}


def _labels(names: Iterable[str], reader: NameReader) -> list[str]:
    """The labels of the known ones among some names, in order, read as a lookup reads them."""
    found = map(reader.read, names)
    return [name.label for name in found if name is not None]


def _published(space: SpaceFolder, labels: LabelSpace) -> dict[str, Ranks]:
    """Per source, the combinations that are published, of objects that the label space still has.

    They are read from the table itself, whose columns ``source`` and ``objects`` every schema
    version has: tables of an older roomtables lose none.
    """
    version = space.named_by_current()
    if version is None:
        return {}
    path = version / "query_scores.parquet"
    refuse_outside(space.path.parent, space.path, version, path)
    try:
        with pq.ParquetFile(path) as file:  # `read_table` would import pandas, a second's work
            table = file.read(["source", "objects"])
    except (pa.ArrowException, OSError):  # built anew all the same
        return {}
    numbers = _numbers(labels)
    found = {}
    for source in pc.unique(table.column("source")).to_pylist():
        rows = table.filter(pc.equal(table.column("source"), source))
        found[source] = _distinct([_rows(rows.column("objects").combine_chunks(), numbers)])
    return found


def _rows(objects: pa.ListArray, numbers: Mapping[str, int]) -> Ranks:
    """Lists of labels as rows of numbers, 0 behind the last; those of unknown labels left out."""
    lengths = pc.list_value_length(objects).to_numpy(zero_copy_only=False)
    labels = objects.flatten().dictionary_encode()
    known = np.array([numbers.get(label, 0) for label in labels.dictionary.to_pylist()], np.int64)
    rows = np.zeros((len(objects), lengths.max(initial=1)), np.int64)
    rows[np.arange(rows.shape[1]) < lengths[:, None]] = known[labels.indices.to_numpy()]
    known_rows: Ranks = rows[np.count_nonzero(rows, axis=1) == lengths]
    return known_rows


def _padded(rows: Sequence[Sequence[int]]) -> Ranks:
    """Rows of unequal length as one array, 0 behind the last number."""
    padded = np.zeros((len(rows), max(map(len, rows), default=0)), np.int64)
    for place, row in enumerate(rows):
        padded[place, : len(row)] = row
    return padded


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
