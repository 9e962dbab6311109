"""What Matterport3D's codes and category names mean, in the paper's words."""

from __future__ import annotations

import csv
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from roomtables.config import load_labels
from roomtables.errors import InputError
from roomtables.labels import normalise
from roomtables.scenes.scene import ReadOptions

UNNAMED = "none"
ROOM_NAMES = {
    "a": "bathroom",
    "b": "bedroom",
    "c": "closet",
    "d": "dining room",
    "e": "lobby",
    "f": "family room",
    "g": "garage",
    "h": "hallway",
    "i": "library",
    "j": "laundry room",
    "k": "kitchen",
    "l": "living room",
    "m": "conference room",
    "n": "lounge",
    "o": "office",
    "p": "porch",
    "r": "game room",
    "s": "staircase",
    "t": "bathroom",
    "u": "utility room",
    "v": "television room",
    "w": "gym",
    "x": "yard",
    "y": "balcony",
    "z": UNNAMED,
    "B": "bar",
    "C": "classroom",
    "D": "dining room",
    "S": "spa",
    "Z": UNNAMED,
    "-": UNNAMED,
}
REJECTED = frozenset({"void", "wall", "floor", "ceiling", "misc", "unlabeled", "-"})


class CategoryLine(Protocol):
    """A category as a ``.house`` file gives it."""

    @property
    def mapping_index(self) -> int: ...
    @property
    def mapping_name(self) -> str: ...
    @property
    def mpcat40(self) -> str: ...


Namer = Callable[[CategoryLine], str | None]


def object_namer(options: ReadOptions) -> Namer:
    """How to name an object from its category line in the label space asked for; None rejects it.

    Raises
    ------
    InputError
        The label space is neither ``mpcat40`` nor ``nyuclass``, or the category mapping is not
        Matterport's.
    """
    if options.object_labels == "mpcat40":
        return _mpcat40
    if options.object_labels != "nyuclass":
        raise InputError(
            "a .house file has the label spaces mpcat40 and nyuclass, not "
            f"{options.object_labels!r}; give `--labels mpcat40` or `--labels nyuclass`"
        )
    if options.category_mapping is not None:
        return _mapped_nyuclass(options.category_mapping)
    options.warn(
        "nyuClass is read off the category names (category_mapping.tsv agrees for nine objects in "
        "ten); give Matterport's own with `--category-mapping category_mapping.tsv`"
    )
    return _nyuclass_by_name


def _mpcat40(category: CategoryLine) -> str | None:
    name = normalise(category.mpcat40)
    if name in REJECTED or name == "objects":
        return None
    return _aliases("mpcat40").get(name, name)


@functools.cache
def _aliases(labels: str) -> dict[str, str]:
    return load_labels(labels).object_aliases


def _nyuclass_by_name(category: CategoryLine) -> str | None:
    """The class that the category's own name says, else its last word, else its mpcat40 name."""
    aliases = _aliases("nyuclass")
    name, mpcat40 = normalise(category.mapping_name), normalise(category.mpcat40)
    parts = [name]
    if not {name, mpcat40} & REJECTED:
        parts += [name.rpartition(" ")[2], mpcat40]
    return next((aliases[part] for part in parts if part in aliases), None)


def _mapped_nyuclass(path: Path) -> Namer:
    classes = _read_mapping(path)
    aliases = _aliases("nyuclass")

    def namer(category: CategoryLine) -> str | None:
        name = classes.get(category.mapping_index)
        return _nyuclass_by_name(category) if name is None else aliases.get(normalise(name))

    return namer


@functools.cache
def _read_mapping(path: Path) -> dict[int, str]:
    """nyuClass by the index of its row in ``category_mapping.tsv``."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file, delimiter="\t", strict=True)
            return {int(row["index"]): row["nyuClass"] or "" for row in rows}
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: not Matterport's category_mapping.tsv (tab-separated, with index, nyuClass)"
        ) from error
