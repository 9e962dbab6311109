"""Keeping a tables folder in order: old versions, score parts, the version before.

Where there are no sentence scores, as on a robot, this needs neither duckdb nor pyarrow.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roomtables.errors import StoreError, needing
from roomtables.schemas import SCORES
from roomtables.storage.aside import REMOVING, remove_folder
from roomtables.storage.client_databases import write_anew
from roomtables.storage.files import build_lock, is_held, listed, refuse_outside, writing
from roomtables.storage.removal import KEPT_VERSIONS, remove_left, remove_old, size_of
from roomtables.storage.versions import CURRENT, STAGING, SpaceFolder, Version

_LEFT = "left by a killed process"
_SPILL = ".spill"  # where a merge of parts puts what does not fit into memory

if TYPE_CHECKING:
    from roomtables.storage.score_cache import SentenceCache


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
            removed += _from_space(space, keep)
        for half in (tables / SCORES).glob(f"{REMOVING}*"):
            removed.append(_remove(tables, half, _LEFT))
        for cache in _caches(tables):
            _end_killed(cache)
            if unused_scores and cache.scorer_id not in _used(tables) and not is_held(cache.folder):
                removed.append(_remove(tables, cache.folder, "scores of a model not in use"))
                continue
            sizes = {path.name: path.stat().st_size for path in cache.folder.iterdir()}
            removed += [
                Removed(str((cache.folder / name).relative_to(tables)), "retired", sizes[name])
                for name in cache.remove_retired()
            ]
        write_anew(tables)
        return removed


def compact(tables: Path) -> list[Compacted]:
    """Merge each scorer's parts into one, each sentence once; readers are not disturbed.

    Raises
    ------
    StoreError
        There is no such folder, another process builds in it, or a part is damaged.
    """
    with needing("merging score parts"):
        from roomtables.storage.database import connect, speaking_plainly

    _require(tables)
    done = []
    with build_lock(tables):
        for cache in _caches(tables):
            _end_killed(cache)
            cache.verify()
            bytes_before = size_of(cache.folder)
            with (
                speaking_plainly(cache.folder),
                connect(spill=cache.folder / _SPILL) as connection,
            ):
                before, after = cache.compact(connection)
            shutil.rmtree(cache.folder / _SPILL, ignore_errors=True)
            done.append(
                Compacted(cache.scorer_id, before, after, bytes_before, size_of(cache.folder))
            )
        write_anew(tables)
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
        published = space.point_at(before.path)
        write_anew(tables)
        return current, published


def _require(tables: Path) -> None:
    if not tables.is_dir():
        raise StoreError(f"no tables in {tables}; run `roomtables build --tables {tables}`")


def _spaces(tables: Path) -> Iterator[SpaceFolder]:
    for folder in sorted(tables.glob("[!.]*")):
        if folder.is_symlink() or folder.name == SCORES:
            continue
        space = SpaceFolder(tables, folder.name)
        started = any(folder.glob(f"{STAGING}*"))
        if started or (folder / CURRENT).is_file() or space.versions():
            yield space


def _caches(tables: Path) -> list[SentenceCache]:
    folders = [path for path in listed(tables / SCORES) if path.is_dir() and path.name[0] != "."]
    refuse_outside(tables, tables / SCORES, *folders)
    if not folders:  # as on a robot, which has no pyarrow either
        return []
    with needing("looking after sentence scores"):
        from roomtables.storage.score_cache import SentenceCache

    return [SentenceCache(tables, folder.name) for folder in folders]


def _end_killed(cache: SentenceCache) -> None:
    """Take in what workers of a killed build finished, and remove what it left besides."""
    cache.end_runs()
    shutil.rmtree(cache.folder / _SPILL, ignore_errors=True)


def _from_space(space: SpaceFolder, keep: int) -> list[Removed]:
    went = [("old version", remove_old(space, keep)), (_LEFT, remove_left(space))]
    return [
        Removed(f"{space.labels}/{name}", what, size)
        for what, sizes in went
        for name, size in sizes.items()
    ]


def _used(tables: Path) -> set[str]:
    versions = [Version.open(path) for space in _spaces(tables) for path in space.versions()]
    return {str(version.manifest.query_scorer_id) for version in versions}


def _remove(tables: Path, folder: Path, what: str) -> Removed:
    refuse_outside(tables, folder)
    size = size_of(folder)
    with writing(folder):
        if folder.name.startswith(REMOVING):
            shutil.rmtree(folder)
        else:
            remove_folder(folder)
    return Removed(str(folder.relative_to(tables)), what, size)
