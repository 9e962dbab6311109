"""Tables that fit a terminal of 80 columns: a long text goes on in the rows below it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import zip_longest
from textwrap import wrap
from typing import Any


def wrapped(rows: Iterable[Mapping[str, Any]], widths: Mapping[str, int]) -> list[dict[str, Any]]:
    """Rows for a table, each column of ``widths`` at most so wide.

    What follows a row's first line stands in rows of its own, blank elsewhere.
    """
    found: list[dict[str, Any]] = []
    for row in rows:
        parts = {name: wrap(str(row[name]), width) for name, width in widths.items()}
        for number, lines in enumerate(zip_longest(*parts.values(), fillvalue="")):
            other = row if number == 0 else dict.fromkeys(row, "")
            found.append({**other, **dict(zip(parts, lines, strict=True))})
        if not any(parts.values()):
            found.append(dict(row))
    return found
