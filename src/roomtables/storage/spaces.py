"""Which label space is meant: by name, by folder, or where a command or a call does not say."""

from __future__ import annotations

from pathlib import Path

from roomtables.config import DEFAULT_LABELS, labels_folder, labels_name, load_labels
from roomtables.errors import StoreError
from roomtables.labels import LABEL_FILES, LabelSpace
from roomtables.storage.files import write_aside, writing
from roomtables.storage.manifest import FileFacts
from roomtables.storage.versions import CURRENT, SpaceFolder

LABELS = "labels"  # the folder of label files in a version


def published_labels(tables: Path) -> tuple[str, ...]:
    """The names of the label spaces that are published in a tables folder, sorted."""
    return tuple(sorted(path.parent.name for path in tables.glob(f"[!.]*/{CURRENT}")))


def find_space(tables: Path, labels: str | None = None) -> SpaceFolder:
    """The folder of a label space: the one named, else ``household``, else the only published one.

    Parameters
    ----------
    tables : the tables folder
    labels : the label space's name, or its folder, as `config.labels_folder` tells them apart

    Raises
    ------
    StoreError
        None is named, several are published, and ``household`` is not among them.
    """
    if labels is not None:
        return SpaceFolder(tables, labels_name(labels))
    published = published_labels(tables)
    if DEFAULT_LABELS in published or not published:
        return SpaceFolder(tables, DEFAULT_LABELS)
    if len(published) > 1:
        raise StoreError(
            f"{tables} holds tables of {', '.join(published)}; say which with `--labels`"
        )
    return SpaceFolder(tables, published[0])


def find_labels(labels: str, tables: Path) -> LabelSpace:
    """The label space that ``--labels`` means: built in, else a folder, else published.

    Raises
    ------
    LabelSpaceError, InputError
        As `config.load_labels`.
    StoreError
        It is published only, and its label files are damaged or were not published with it.
    """
    if labels_folder(labels) is not None or labels not in published_labels(tables):
        return load_labels(labels)
    version = SpaceFolder(tables, labels).current()
    for name in LABEL_FILES:
        path = version.path / LABELS / name
        noted = version.manifest.files.get(f"{LABELS}/{name}")
        if noted is None or not path.is_file() or FileFacts.of(path) != noted:
            raise StoreError(
                f"{path} is not there as it was published; build once from the label space's "
                "folder (`--labels DIR`)"
            )
    return LabelSpace.load(version.path / LABELS, labels)


def publish_labels(labels: LabelSpace, staging: Path) -> None:
    """Write a label space's files into the folder of a version, for whoever has its name alone."""
    folder = staging / LABELS
    with writing(folder):
        folder.mkdir()
    for name, text in labels.csv_files().items():
        write_aside(folder / name, text.encode())
