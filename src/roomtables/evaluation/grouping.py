"""Rooms that people use for one another, so that an answer in the right group counts as well."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path

from roomtables.config import builtin_labels, labels_folder
from roomtables.csv_rows import read_csv
from roomtables.errors import InputError
from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables

COLUMNS = ("room", "group")
_FILE = "groups.csv"  # of a built-in label space, beside its rooms.csv


def read_groups(file_or_labels: str | Path, tables: RoomTables) -> dict[str, str]:
    """Room label → group, from a CSV of ``room`` and ``group``; other columns are for people.

    A bare name of a built-in label space stands for the groups that it comes with. Rooms may be
    named by any of their synonyms. A room that no row names is a group of its own.

    Raises
    ------
    InputError
        The file cannot be read or is malformed, a row leaves a field empty, names a room twice, or
        one that the tables do not have.
    """
    path = _path(file_or_labels)
    candidates = {room.label for room in tables.candidates}
    known = {room.label for room in tables.lookup.rooms} | candidates
    aliases = {name: name for name in known} | dict(tables.lookup.room_aliases)
    groups: dict[str, str] = {}
    for where, row in read_csv(path, COLUMNS):
        name, group = normalise(row["room"]), normalise(row["group"])
        if not name or not group:
            raise InputError(f"{where}: `{'group' if name else 'room'}` is empty")
        label = aliases.get(name)
        if label is None:
            raise InputError(
                f"{where}: no room {row['room']!r} in label space {tables.version.path.parent.name}"
                f"{_nearest(name, aliases)}"
            )
        if label in groups:
            raise InputError(f"{where}: room {label!r} is in group {groups[label]!r} already")
        groups[label] = group
    return groups


def in_one_group(groups: Mapping[str, str], first: str, second: str) -> bool:
    """Whether two rooms are the same, or of one group."""
    return first == second or (first in groups and groups[first] == groups.get(second))


def _path(file_or_labels: str | Path) -> Path:
    """The file that ``--groups`` means."""
    name = str(file_or_labels)
    if name in builtin_labels() and (folder := labels_folder(name)):
        return folder / _FILE
    return Path(file_or_labels)


def _nearest(name: str, aliases: Mapping[str, str]) -> str:
    """The end of a message that suggests the rooms that are spelled alike, if any are."""
    close = difflib.get_close_matches(name, sorted(aliases), 3)
    if not close:
        return "; see its rooms.csv"
    labels = dict.fromkeys(aliases[spelled] for spelled in close)
    return f"; did you mean {', '.join(labels)}?"
