"""What Matterport3D's codes and category names mean, in the paper's words."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from roomtables.config import labels_name, load_labels
from roomtables.csv_rows import csv_lines
from roomtables.errors import InputError
from roomtables.labels import normalise
from roomtables.scenes.scene import ReadOptions

MPCAT40, NYUCLASS = "mpcat40", "nyuclass"
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
_REJECTED = frozenset({"void", "wall", "floor", "ceiling", "misc", "unlabeled", "-"})


@dataclass(frozen=True, slots=True)
class Category:
    """A ``C`` line: index and name in Matterport's category mapping, and the mpcat40 name."""

    mapping_index: int
    mapping_name: str
    mpcat40: str


Namer = Callable[[Category], str | None]


def house_labels(labels: str | None) -> str:
    """The label space to name a house's objects in, where tables of ``labels`` are to answer."""
    return NYUCLASS if labels and labels_name(labels) == NYUCLASS else MPCAT40


def object_namer(options: ReadOptions) -> Namer:
    """What names an object by its category, in the label space asked for; None leaves it out.

    Raises
    ------
    InputError
        The label space is neither ``mpcat40`` nor ``nyuclass``, or the category mapping is not
        Matterport's.
    """
    if options.object_labels == MPCAT40:
        return _mpcat40
    if options.object_labels != NYUCLASS:
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


def _mpcat40(category: Category) -> str | None:
    name = normalise(category.mpcat40)
    if name in _REJECTED or name == "objects":
        return None
    return _aliases(MPCAT40).get(name, name)


@functools.cache
def _aliases(labels: str) -> dict[str, str]:
    """Every name of a built-in label space's objects, and the label that it means."""
    return load_labels(labels).object_aliases


def _nyuclass_by_name(category: Category) -> str | None:
    """The class that the category's own name says, else its last word, else its mpcat40 name."""
    aliases = _aliases(NYUCLASS)
    name, mpcat40 = normalise(category.mapping_name), normalise(category.mpcat40)
    parts = [name]
    if not {name, mpcat40} & _REJECTED:
        parts += [name.rpartition(" ")[2], mpcat40]
    return next((aliases[part] for part in parts if part in aliases), None)


def _mapped_nyuclass(path: Path) -> Namer:
    """A namer that looks the category up in ``category_mapping.tsv``."""
    classes = _read_mapping(path)
    aliases = _aliases(NYUCLASS)

    def namer(category: Category) -> str | None:
        name = classes.get(category.mapping_index)
        return _nyuclass_by_name(category) if name is None else aliases.get(normalise(name))

    return namer


@functools.cache
def _read_mapping(path: Path) -> dict[int, str]:
    """nyuClass by the index of its row in ``category_mapping.tsv``."""
    rows = csv_lines(path, delimiter="\t", strict=True)
    try:
        _, header = next(rows)
        index, name = header.index("index"), header.index("nyuClass")
        return {int(row[index]): "".join(row[name : name + 1]) for _, row in rows if row}
    except (StopIteration, IndexError, ValueError) as error:
        raise InputError(
            f"{path}: not Matterport's category_mapping.tsv (tab-separated, with index, nyuClass)"
        ) from error
