"""Which label space's tables are meant, where a command or a call does not say."""

from __future__ import annotations

from pathlib import Path

from roomtables.config import DEFAULT_LABELS
from roomtables.errors import StoreError
from roomtables.storage.versions import CURRENT, SpaceFolder


def published_labels(tables: Path) -> tuple[str, ...]:
    """The names of the label spaces that are published in a tables folder, sorted."""
    return tuple(sorted(path.parent.name for path in tables.glob(f"[!.]*/{CURRENT}")))


def find_space(tables: Path, labels: str | None = None) -> SpaceFolder:
    """The folder of a label space: the one named, else ``household``, else the only published one.

    Parameters
    ----------
    tables : the tables folder
    labels : the label space's name, or its folder, whose base name is its name

    Raises
    ------
    StoreError
        None is named, several are published, and ``household`` is not among them.
    """
    if labels is not None:
        return SpaceFolder(tables, Path(labels).name)
    published = published_labels(tables)
    if DEFAULT_LABELS in published or not published:
        return SpaceFolder(tables, DEFAULT_LABELS)
    if len(published) > 1:
        raise StoreError(
            f"{tables} holds tables of {', '.join(published)}; say which with `--labels`"
        )
    return SpaceFolder(tables, published[0])
