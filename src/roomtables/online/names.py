"""From the names that a robot gives to the ranks of the objects that they name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from roomtables.errors import InputError
from roomtables.labels import normalise

UNLISTED = 0
_REMEMBERED = 50_000  # spellings, so that no stream of names fills the memory


class Vocabulary(dict[str, int]):
    """Name → rank of the object it names (1 = most informative), or ``UNLISTED``.

    A new spelling is normalised and remembered, so that it costs one look-up the next time. Threads
    may share one: all they can do is remember the same twice.

    Parameters
    ----------
    aliases : normalised name → label
    ranks : label → rank
    """

    def __init__(self, aliases: Mapping[str, str], ranks: Mapping[str, int]) -> None:
        super().__init__((spelled, ranks[label]) for spelled, label in aliases.items())
        self._listed = dict(self)
        self._full = len(self) + _REMEMBERED

    def __missing__(self, name: object) -> int:
        if not isinstance(name, str):
            raise InputError(f"objects must be strings, not {name!r}; give the names of objects")
        rank = self._listed.get(normalise(name), UNLISTED)
        if len(self) < self._full:
            self[name] = rank
        return rank

    def unlisted(self, names: Iterable[str]) -> dict[str, str]:
        """The names that no object bears, once each: normalised → as first given."""
        unlisted: dict[str, str] = {}
        for name in names:
            if self[name] == UNLISTED and (spelled := normalise(name)):
                unlisted.setdefault(spelled, name)
        return unlisted


def as_names(objects: Iterable[str]) -> Sequence[str]:
    """The objects of one room, in a sequence.

    Raises
    ------
    InputError
        They are one string: a list of names is missing its brackets.
    """
    if isinstance(objects, str):
        raise InputError(f"objects must be a list of names, not {objects!r}; give [{objects!r}]")
    return objects if isinstance(objects, list | tuple) else list(objects)
