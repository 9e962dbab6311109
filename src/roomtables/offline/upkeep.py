"""Keeping a tables folder in order: old versions, score parts, the version before."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from roomtables.errors import StoreError
from roomtables.storage.database import connect, speaking_plainly
from roomtables.storage.files import build_lock, is_held, refuse_outside, writing
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.score_parts import SCORES, listed
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
            with (
                speaking_plainly(cache.folder),
                connect(spill=cache.folder / ".spill") as connection,
            ):
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
    folders = [path for path in listed(tables / SCORES) if path.is_dir() and path.name[0] != "."]
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
    return {str(version.manifest.query_scorer_id) for version in versions}


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
