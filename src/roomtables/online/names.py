"""From the names that a robot gives to the ranks of the objects that they name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from roomtables.errors import InputError
from roomtables.labels import normalise
from roomtables.names import NameReader

UNLISTED = 0
# Spellings that are remembered, and the longest: no stream of names fills the memory.
_REMEMBERED = 50_000
_LONGEST = 200


class Vocabulary(dict[str, int]):
    """Name → rank of the object it names (1 = most informative), or ``UNLISTED``.

    A new spelling is read and remembered, so that it costs one look-up the next time. Threads may
    share one: all they can do is remember the same twice.

    Parameters
    ----------
    reader : what reads names
    ranks : label → rank
    """

    def __init__(self, reader: NameReader, ranks: Mapping[str, int]) -> None:
        super().__init__((name, ranks[found.label]) for name, found in reader.names.items())
        self._reader = reader
        self._ranks = ranks
        self._full = len(self) + _REMEMBERED

    def __missing__(self, name: str) -> int:
        found = self._reader.read(name)
        rank = UNLISTED if found is None else self._ranks[found.label]
        if len(self) < self._full and len(name) <= _LONGEST:
            self[name] = rank
        return rank

    def unlisted(self, names: Iterable[str]) -> dict[str, str]:
        """The names that no object bears, once each: normalised → as first given."""
        unlisted: dict[str, str] = {}
        for name in names:
            if self[name] == UNLISTED and (spelled := normalise(name)):
                unlisted.setdefault(spelled, name)
        return unlisted


def as_names(objects: Iterable[str]) -> tuple[str, ...]:
    """The objects of one room; what a caller does with their list later changes nothing.

    Raises
    ------
    InputError
        They are one string (a list of names is missing its brackets), or not all are strings.
    """
    if isinstance(objects, str):
        raise InputError(f"objects must be a list of names, not {objects!r}; give [{objects!r}]")
    try:
        names = tuple(objects)
        "".join(names)  # the quickest way to see that all are strings
    except TypeError as error:
        wrong = repr(objects)[:200]
        raise InputError(f"objects must be strings, not {wrong}; give the names of objects") from (
            error
        )
    return names
