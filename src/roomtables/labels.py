"""Label spaces: the names of objects and rooms, how they read in a sentence, what else they are.

A label space is a folder with ``objects.csv`` (``object``; optionally ``plural``, ``synonyms``) and
``rooms.csv`` (``room``; optionally ``article``, ``synonyms``, ``predicted``). What a column leaves
empty is derived. Labels are held sorted, so the order of a file changes nothing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from roomtables import english
from roomtables.csv_rows import read_csv
from roomtables.errors import InputError, LabelSpaceError
from roomtables.schemas import RESERVED_ROOMS, RESERVED_SPACES

LABEL_FILES = ("objects.csv", "rooms.csv")
OBJECT_COLUMNS = ("object", "plural", "synonyms")
ROOM_COLUMNS = ("room", "article", "synonyms", "predicted")
_TRUTH_WORDS = {"": True, "true": True, "1": True, "yes": True} | {
    "false": False,
    "0": False,
    "no": False,
}


def normalise(text: str) -> str:
    """A label as it is compared: lower case, ``_`` as a space, single spaces, none around it."""
    return " ".join(text.replace("_", " ").casefold().split())


# How a name is read: as the label, as a plural (or the singular of a plural), or as a synonym.
LABEL, PLURAL, SYNONYM = "label", "plural", "synonym"


class Name(NamedTuple):
    """What a name stands for: a label, and how it was read."""

    label: str
    how: str


@dataclass(frozen=True, slots=True)
class ObjectLabel:
    """An object's label, its plural as a sentence says it, and its other names."""

    label: str
    plural: str
    synonyms: tuple[str, ...] = ()

    @classmethod
    def named(cls, label: str) -> ObjectLabel:
        """An object that no label space lists, its plural derived."""
        return cls(label, english.pluralise(label))


@dataclass(frozen=True, slots=True)
class RoomLabel:
    """A room's label, its article, its other names, and whether it may be the answer."""

    label: str
    article: str
    synonyms: tuple[str, ...] = ()
    predicted: bool = True

    @classmethod
    def named(cls, label: str) -> RoomLabel:
        """A room that no label space lists, its article derived."""
        return cls(label, english.article(label))

    @property
    def phrase(self) -> str:
        """The room with its article, as a sentence says it: ``an office``."""
        return f"{self.article} {self.label}"


@dataclass(frozen=True)
class LabelSpace:
    """The objects and rooms that tables are built for, each sorted by label.

    Raises
    ------
    LabelSpaceError
        No object, no predicted room, a label twice, a synonym that two labels claim, or a name that
        the tables use themselves.
    """

    name: str
    objects: tuple[ObjectLabel, ...]
    rooms: tuple[RoomLabel, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", tuple(sorted(self.objects, key=_by_label)))
        object.__setattr__(self, "rooms", tuple(sorted(self.rooms, key=_by_label)))
        if not self.objects:
            raise LabelSpaceError(f"label space {self.name} has no object; add one to objects.csv")
        if not self.predicted_rooms:
            raise LabelSpaceError(f"label space {self.name} has no predicted room; see rooms.csv")
        _check_reserved(self)
        _check_distinct(self.objects, f"label space {self.name}, objects.csv")
        _check_distinct(self.rooms, f"label space {self.name}, rooms.csv")

    @cached_property
    def predicted_rooms(self) -> tuple[RoomLabel, ...]:
        """R⁺: the rooms that may be the answer, sorted by label."""
        return tuple(room for room in self.rooms if room.predicted)

    @cached_property
    def object_names(self) -> dict[str, Name]:
        """Every name of an object that is read as it stands, normalised: table ``names``."""
        return names_of_objects(self.objects)

    @cached_property
    def object_aliases(self) -> dict[str, str]:
        """Every accepted spelling of an object, normalised → its label."""
        return {name: found.label for name, found in self.object_names.items()}

    @cached_property
    def room_aliases(self) -> dict[str, str]:
        """Every accepted spelling of a room, normalised → its label."""
        return {name: found.label for name, found in _names(self.rooms, {}).items()}

    @classmethod
    def load(cls, folder: Path, name: str | None = None) -> LabelSpace:
        """A label space from its folder, whose base name is its name where none is given.

        Raises
        ------
        InputError, LabelSpaceError
            A file is missing or malformed; the message names file and line.
        """
        objects = [
            ObjectLabel(label, row["plural"] or english.pluralise(label), _split(row["synonyms"]))
            for label, row, _ in _rows(folder / "objects.csv", OBJECT_COLUMNS)
        ]
        rooms = [
            RoomLabel(
                label,
                row["article"] or english.article(label),
                _split(row["synonyms"]),
                _truth(row["predicted"], where),
            )
            for label, row, where in _rows(folder / "rooms.csv", ROOM_COLUMNS)
        ]
        return cls(name or folder.resolve().name, tuple(objects), tuple(rooms))

    @classmethod
    def named(cls, name: str, objects: Iterable[str], rooms: Iterable[str]) -> LabelSpace:
        """A label space from bare labels, normalised, everything else derived."""
        object_labels = {normalise(label) for label in objects} - {""}
        room_labels = {normalise(label) for label in rooms} - {""}
        return cls(
            name,
            tuple(ObjectLabel.named(label) for label in object_labels),
            tuple(RoomLabel.named(label) for label in room_labels),
        )

    def csv_files(self) -> dict[str, str]:
        """The folder's files as text, file name → content."""
        objects = [[o.label, o.plural, "|".join(o.synonyms)] for o in self.objects]
        rooms = [
            [r.label, r.article, "|".join(r.synonyms), str(r.predicted).lower()] for r in self.rooms
        ]
        return {
            "objects.csv": _csv_text(OBJECT_COLUMNS, objects),
            "rooms.csv": _csv_text(ROOM_COLUMNS, rooms),
        }


def _by_label(label: ObjectLabel | RoomLabel) -> str:
    return label.label


def _check_reserved(space: LabelSpace) -> None:
    if space.name in RESERVED_SPACES or space.name.startswith("."):
        raise LabelSpaceError(
            f"label space {space.name!r}: the tables folder uses this name itself; rename it"
        )
    if not space.name or "/" in space.name or not space.name.isprintable():
        raise LabelSpaceError(
            f"label space {space.name!r}: its name, which its folder gives it, must be one of "
            "printable characters without a slash; rename it"
        )
    for room in space.rooms:
        if room.label in RESERVED_ROOMS:
            raise LabelSpaceError(
                f"label space {space.name}, rooms.csv: a room cannot be called {room.label!r}, "
                "which is a column of the query scores; give it another name"
            )


def _check_distinct(labels: Sequence[ObjectLabel | RoomLabel], where: str) -> None:
    owner: dict[str, str] = {}
    for label in labels:
        spelled = normalise(label.label)
        if spelled in owner:
            raise LabelSpaceError(f"{where}: {label.label!r} is listed twice; remove one")
        owner[spelled] = label.label
    for label in labels:
        for synonym in label.synonyms:
            other = owner.setdefault(normalise(synonym), label.label)
            if other != label.label:
                raise LabelSpaceError(
                    f"{where}: synonym {synonym!r} belongs to {other!r} and {label.label!r}; "
                    "remove one"
                )


def names_of_objects(objects: Sequence[ObjectLabel]) -> dict[str, Name]:
    """Every name of some objects that is read as it stands, normalised → what it stands for."""
    return _names(objects, {o.label: o.plural for o in objects})


def _names(
    labels: Sequence[ObjectLabel | RoomLabel], plurals: Mapping[str, str]
) -> dict[str, Name]:
    """What is written wins over what is derived; among derived ones the label that sorts first."""
    written: dict[str, Name] = {}
    inflected: dict[str, Name] = {}
    for label in labels:
        names = [label.label, *label.synonyms]
        written |= {normalise(name): Name(label.label, SYNONYM) for name in label.synonyms}
        written[normalise(label.label)] = Name(label.label, LABEL)
        forms = {plurals.get(label.label)}
        forms.update(map(english.pluralise, names), map(english.singular, names))
        for form in forms - {None}:
            inflected.setdefault(normalise(str(form)), Name(label.label, PLURAL))
    return inflected | written


def _rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[str, Mapping[str, str], str]]:
    """Label, row and place of each row; columns that the file lacks read as empty."""
    for where, row in read_csv(path, required=columns[:1]):
        label = normalise(row[columns[0]])
        if not label:
            raise InputError(f"{where}: empty `{columns[0]}`")
        yield label, {column: row.get(column, "").strip() for column in columns}, where


def _split(text: str) -> tuple[str, ...]:
    return tuple(sorted({normalise(part) for part in text.split("|")} - {""}))


def _truth(text: str, where: str) -> bool:
    try:
        return _TRUTH_WORDS[text.casefold()]
    except KeyError:
        raise InputError(f"{where}: `predicted` must be true or false, not {text[:40]!r}") from None


def _csv_text(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return buffer.getvalue()
