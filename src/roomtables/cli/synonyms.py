"""Tells which names of a scene were read as synonyms of a label."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import click

from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables
from roomtables.rooms import Room

_MOST_SHOWN = 12


class Synonyms:
    """Collects the synonyms among the names of rooms that pass through it."""

    def __init__(self, tables: RoomTables) -> None:
        self._labels = tables.twin.object_aliases
        self._plurals = {entry.label: normalise(entry.plural) for entry in tables.twin.objects}
        self._used: dict[str, str] = {}

    def watch(self, rooms: Iterable[Room]) -> Iterator[Room]:
        """The rooms, unchanged."""
        for room in rooms:
            for name in room.objects:
                spelled = normalise(name)
                label = self._labels.get(spelled)
                if label is not None and spelled not in (label, self._plurals[label]):
                    self._used[spelled] = label
            yield room

    def report(self) -> None:
        """One line on stderr, if there was any."""
        if self._used:
            pairs = [f"{name} = {label}" for name, label in sorted(self._used.items())]
            more = ", …" if len(pairs) > _MOST_SHOWN else ""
            shown = ", ".join(pairs[:_MOST_SHOWN])
            click.echo(f"read as synonyms: {shown}{more}", err=True)
