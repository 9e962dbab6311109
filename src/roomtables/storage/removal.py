"""What may go from a label space's folder: old versions, and what killed processes left there.

Only what a build can be shown to have written is removed, nothing behind a symbolic link, and never
what ``CURRENT`` names. Everything here is for whoever holds the build lock.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path

from roomtables.limits import JSON_BYTES, json_value, read_bytes
from roomtables.storage.aside import REMOVING, asides, remove_abandoned, remove_folder
from roomtables.storage.client_databases import FOLDER as DATABASES
from roomtables.storage.evaluations import FOLDER as EVALUATIONS
from roomtables.storage.files import is_held, refuse_outside, writing
from roomtables.storage.miss_log import FOLDER as MISSES
from roomtables.storage.versions import MANIFEST, NAME, STAGING, SpaceFolder

KEPT_VERSIONS = 2
# Folders of a label space in which files are written aside at any time.
_WRITTEN_INTO = (MISSES, EVALUATIONS, DATABASES)
# A version that is being written, by the process's id, or removed, by the version's name.
_HALF = re.compile(rf"\.pulling-files|{re.escape(STAGING)}\d+|{re.escape(REMOVING)}{NAME.pattern}")

log = logging.getLogger(__name__)


def remove_old(space: SpaceFolder, keep: int = KEPT_VERSIONS) -> dict[str, int]:
    """Remove all but the newest versions, the current one, and those that a reader holds.

    Returns the names of those removed, with their bytes. What no build wrote stays, and so does
    every version where ``CURRENT`` does not say which one is published.
    """
    current = space.named_by_current()
    if current is None or space.path.is_symlink():
        return {}
    removed = {}
    for path in space.versions()[: -max(keep, 1)]:
        if path.resolve() == current.resolve() or is_held(path):
            continue
        if foreign := _foreign(path):
            log.warning("%s stays: no build wrote its %s", path, foreign)
            continue
        size = size_of(path)
        with writing(path):
            remove_folder(path)
        removed[path.name] = size
    return removed


def abandoned(space: SpaceFolder) -> list[Path]:
    """What killed processes left half written or half removed, by path."""
    half = [path for path in space.path.glob(".*-*") if _HALF.fullmatch(path.name)]
    folders = [space.path, *(space.path / name for name in _WRITTEN_INTO)]
    found = (asides(folder) for folder in folders if not folder.is_symlink())
    return sorted(half + [path for paths in found for path in paths])


def remove_left(space: SpaceFolder) -> dict[str, int]:
    """Remove what is abandoned; the names of what is gone, with their bytes."""
    refuse_outside(space.path.parent, space.path)
    sizes = {path: size_of(path) for path in abandoned(space)}
    gone = (path for path in sizes if remove_abandoned(path))
    return {path.relative_to(space.path).as_posix(): sizes[path] for path in gone}


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    paths = path.rglob("*") if path.is_dir() and not path.is_symlink() else [path]
    return sum(each.lstat().st_size for each in paths if each.is_symlink() or not each.is_dir())


def _foreign(version: Path) -> str:
    """Files in a version's folder that its manifest does not name; empty where it names all."""
    if version.is_symlink():
        return "link"
    try:
        noted = json_value(read_bytes(version / MANIFEST, JSON_BYTES))["files"].keys()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return MANIFEST
    files = (path for path in version.rglob("*") if path.is_symlink() or not path.is_dir())
    found = {path.relative_to(version).as_posix() for path in files}
    return ", ".join(sorted(found - noted - {MANIFEST})[:3])
