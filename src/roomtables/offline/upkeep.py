"""Keeping a tables folder in order: old versions, score parts, the version before."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import duckdb

from roomtables.errors import StoreError
from roomtables.offline.stages import interruptible
from roomtables.storage.files import build_lock, is_held, refuse_outside, writing
from roomtables.storage.score_cache import SentenceCache, quote
from roomtables.storage.score_parts import SCORES
from roomtables.storage.versions import CURRENT, KEPT_VERSIONS, MANIFEST, SpaceFolder, Version


@dataclass(frozen=True)
class Removed:
    """Something that was removed: its path in the tables folder, what it was, its size in bytes."""

    path: str
    what: str
    bytes: int


@dataclass(frozen=True)
class Compacted:
    """A scorer whose parts were merged: how many parts there were and are, and bytes."""

    scorer_id: str
    parts_before: int
    parts_after: int
    bytes_before: int
    bytes_after: int

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def collect_garbage(
    tables: Path, keep: int = KEPT_VERSIONS, unused_scores: bool = False
) -> list[Removed]:
    """Remove old versions, retired score parts and what killed builds left behind.

    Kept are the newest ``keep`` versions of each label space, the published one, and whatever a
    reader holds (`roomtables sql` does; mapped tables outlive the removal of their files). With
    ``unused_scores``, the scores of models that no remaining version was built with go too.

    Raises
    ------
    StoreError
        There is no such folder, another process builds in it, or a file cannot be removed.
    """
    _require(tables)
    with build_lock(tables):
        removed = []
        for space in _spaces(tables):
            removed += _without_versions(tables, space, keep)
        for cache in _caches(tables):
            cache.end_runs()
            if unused_scores and cache.scorer_id not in _used(tables) and not is_held(cache.folder):
                removed.append(_remove(tables, cache.folder, "scores of a model not in use"))
                continue
            sizes = {path.name: path.stat().st_size for path in cache.folder.iterdir()}
            removed += [
                Removed(str((cache.folder / name).relative_to(tables)), "retired", sizes[name])
                for name in cache.remove_retired()
            ]
        return removed


def compact(tables: Path) -> list[Compacted]:
    """Merge each scorer's parts into one, each sentence once; readers are not disturbed.

    Raises
    ------
    StoreError
        There is no such folder, another process builds in it, or a part is damaged.
    """
    _require(tables)
    done = []
    with build_lock(tables):
        for cache in _caches(tables):
            cache.end_runs()
            cache.verify()
            bytes_before = _size(cache.folder)
            with interruptible(cache.folder), duckdb.connect() as connection:
                connection.execute(f"set temp_directory = {quote(cache.folder / '.spill')}")
                before, after = cache.compact(connection)
            shutil.rmtree(cache.folder / ".spill", ignore_errors=True)
            done.append(
                Compacted(cache.scorer_id, before, after, bytes_before, _size(cache.folder))
            )
    return done


def roll_back(tables: Path, labels: str) -> tuple[Version, Version]:
    """Publish the version before the published one; both, the one left first.

    Raises
    ------
    StoreError
        Nothing is published, there is no version before, or another process builds.
    """
    _require(tables)
    with build_lock(tables):
        space = SpaceFolder(tables, labels)
        current = space.current()
        before = space.before(current)
        before.verify()
        return current, space.point_at(before.path)


def _require(tables: Path) -> None:
    if not tables.is_dir():
        raise StoreError(f"no tables in {tables}; run `roomtables build --tables {tables}`")


def _spaces(tables: Path) -> Iterator[SpaceFolder]:
    for folder in sorted(tables.glob("[!.]*")):
        if (folder / CURRENT).is_file() or any(folder.glob(f"*/{MANIFEST}")):
            yield SpaceFolder(tables, folder.name)


def _caches(tables: Path) -> list[SentenceCache]:
    folders = sorted(path for path in (tables / SCORES).glob("[!.]*") if path.is_dir())
    refuse_outside(tables, tables / SCORES, *folders)
    return [SentenceCache(tables, folder.name) for folder in folders]


def _without_versions(tables: Path, space: SpaceFolder, keep: int) -> list[Removed]:
    sizes = {path.name: _size(path) for path in space.versions()}
    removed = [
        Removed(f"{space.labels}/{name}", "old version", sizes[name])
        for name in space.remove_old(keep)
    ]
    abandoned = [*space.path.glob(".staging-*"), *_half_removed(space)]
    return removed + [_remove(tables, path, "left by a killed build") for path in abandoned]


def _half_removed(space: SpaceFolder) -> Iterator[Path]:
    """Version folders whose manifest is gone: a removal that was killed."""
    for path in space.path.glob("[0-9]*-*"):
        if path.is_dir() and not (path / MANIFEST).exists():
            yield path


def _used(tables: Path) -> set[str]:
    versions = [Version.open(path) for space in _spaces(tables) for path in space.versions()]
    return {str(version.manifest["query_scorer_id"]) for version in versions}


def _remove(tables: Path, path: Path, what: str) -> Removed:
    refuse_outside(tables, path)
    size = _size(path)
    with writing(path):
        if path.is_symlink() or path.is_file():
            path.unlink()
        else:
            shutil.rmtree(path)
    return Removed(str(path.relative_to(tables)), what, size)


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


_SETTINGS = ("scorer_id", "query_scorer_id", "k", "template", "reduction", "smoothing", "decision")
# One row per source and object: its entropy and the room it speaks for most.
_OBJECTS = """
select source, object, any_value(entropy_nats) as entropy_nats,
    first(room order by p_room_given_object desc, room) as first_room
from read_parquet({cooccurrence}) as c join read_parquet({entropy}) as e using (source, object)
group by source, object
"""
_MOVED = """
select source, object,
    before.entropy_nats as entropy_before, after.entropy_nats as entropy_after,
    after.entropy_nats - before.entropy_nats as entropy_change,
    before.first_room as first_room_before, after.first_room as first_room_after
from ({before}) as before full join ({after}) as after using (source, object)
where before.entropy_nats is distinct from after.entropy_nats
    or before.first_room is distinct from after.first_room
order by before.first_room is not distinct from after.first_room,
    abs(entropy_change) desc nulls first, source, object
"""
# A combination's answer is the position of its best room; a tie goes to the room that sorts first.
_COMBINATIONS = """
select source,
    count(*) filter (before.objects is not null and after.objects is not null) as held_in_both,
    count(*) filter (before.objects is null) as added,
    count(*) filter (after.objects is null) as removed,
    count(*) filter (
        list_position(before.scores, list_max(before.scores))
        <> list_position(after.scores, list_max(after.scores))
    ) as other_room
from (select source, list_sort(objects) as objects, scores from read_parquet({before})) as before
full join (select source, list_sort(objects) as objects, scores from read_parquet({after})) as after
    using (source, objects)
group by source
order by source
"""


@dataclass(frozen=True)
class Diff:
    """Two versions compared.

    Attributes
    ----------
    settings : name → (before, after), where they differ
    objects : rows of objects that moved, those with another first room first, then by how much
        their entropy (nats) changed
    combinations : per source, how many combinations are held in both, added, removed, and have
        another best room; empty where the rooms differ
    """

    labels: str
    before: str
    after: str
    settings: Mapping[str, tuple[Any, Any]]
    objects: list[dict[str, Any]]
    combinations: list[dict[str, Any]]

    def as_json(self) -> dict[str, Any]:
        """The comparison as plain data."""
        return asdict(self)


def compare(before: Version, after: Version) -> Diff:
    """What changed from one version to another of the same label space.

    Raises
    ------
    StoreError
        A table of a version is damaged.
    """
    before.verify()
    after.verify()
    moved = _MOVED.format(before=_objects(before), after=_objects(after))
    same_rooms = before.manifest["predicted_rooms"] == after.manifest["predicted_rooms"]
    counts = _COMBINATIONS.format(
        before=quote(before.path / "query_scores.parquet"),
        after=quote(after.path / "query_scores.parquet"),
    )
    with duckdb.connect() as connection:
        return Diff(
            after.manifest["labels"],
            before.name,
            after.name,
            {
                name: (before.manifest.get(name), after.manifest.get(name))
                for name in _SETTINGS
                if before.manifest.get(name) != after.manifest.get(name)
            },
            _rows(connection, moved),
            _rows(connection, counts) if same_rooms else [],
        )


def _objects(version: Version) -> str:
    names = ("cooccurrence", "entropy")
    return _OBJECTS.format(**{name: quote(version.path / f"{name}.parquet") for name in names})


def _rows(connection: duckdb.DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    found = connection.execute(query)
    columns = [column[0] for column in found.description or ()]
    return [dict(zip(columns, row, strict=True)) for row in found.fetchall()]
