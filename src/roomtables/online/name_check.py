"""How much of what a robot calls things is understood, name by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from roomtables.names import NameReader
from roomtables.wording import percent


@dataclass(frozen=True)
class CheckedName:
    """A name, how often it was given, and the object that it is read as.

    Attributes
    ----------
    object : the label of the object, or ``None`` for a name that is not understood
    how : ``label``, ``plural``, ``synonym``, ``spelling`` or ``compound``; ``None`` likewise
    nearest : known names that are spelled like one that is not understood, the most like it first
    """

    name: str
    times: int
    object: str | None
    how: str | None
    nearest: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The row under the contract's keys."""
        return asdict(self)


def check_names(reader: NameReader, given: Mapping[str, int]) -> list[CheckedName]:
    """Each name with what it is read as; those not understood first, then the most frequent.

    Parameters
    ----------
    reader : reads the names of a label space
    given : name → how often it was given
    """
    checked = []
    for name, times in given.items():
        found = reader.read(name)
        if found is None:
            row = CheckedName(name, times, None, None, tuple(reader.nearest(name)))
        else:
            row = CheckedName(name, times, found.label, found.how)
        checked.append(row)
    return sorted(checked, key=lambda row: (row.object is not None, -row.times, row.name))


def summary(rows: Sequence[CheckedName]) -> str:
    """How many of the names, and what share of all that bear them, is understood."""
    understood = [row for row in rows if row.object is not None]
    line = f"{len(understood):,} of {len(rows):,} names understood"
    objects = sum(row.times for row in rows)
    if objects > len(rows):
        share = sum(row.times for row in understood) / objects
        line += f", {percent(share)} of {objects:,} objects"
    return line
