"""Tables of text as wide as the terminal: columns are left out or set beneath, lists are folded.

What is printed elsewhere, into a pipe or a file, has every column and one line per row, whatever
the width: programs and `grep` read that.
"""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import click

_GAP = 2  # characters between two columns
_PADDING = 2  # characters that tabulate leaves behind a column's name
_LEAST = 40  # characters that a table may always take
_FOLDED = 30  # to less than this no column is folded whose words are longer
_LIST = ", "  # between the parts of a list
_TIED = "\xa0"  # a space at which no line is broken

Row = Sequence[str]


@dataclass(frozen=True)
class Grid:
    """A table of text: names of the columns, and rows of as many cells."""

    names: Row
    rows: Sequence[Row]

    @property
    def widths(self) -> list[int]:
        """Characters of each column."""
        return [
            max(len(name) + _PADDING, *map(_longest, cells), 0) for name, *cells in self._columns()
        ]

    @property
    def width(self) -> int:
        """Characters of a line."""
        return _width(self.widths)

    def least_widths(self, between: str | None = None) -> list[int]:
        """What each column can be folded to, ``between`` words or the parts of a list.

        Its name is never broken; of its cells what is longer than ``_FOLDED`` is.
        """
        widths = []
        for name, *cells in self._columns():
            longest = max((_longest_part(cell, between) for cell in cells), default=0)
            widths.append(max(len(name) + _PADDING, min(_FOLDED, longest)))
        return widths

    def without(self, *names: str) -> Grid:
        """The table without some columns."""
        kept = [at for at, name in enumerate(self.names) if name not in names]
        return self.only(kept)

    def only(self, places: Sequence[int]) -> Grid:
        """The table with the columns at these places."""
        return Grid(
            [self.names[at] for at in places], [[row[at] for at in places] for row in self.rows]
        )

    def column(self, name: str) -> list[str]:
        """The cells of a column; none where there is no such column."""
        return [row[self.names.index(name)] for row in self.rows] if name in self.names else []

    def folded(self, width: int) -> Grid:
        """The table with the cells of its widest columns folded, so that a line has the width."""
        widths, least = self.widths, self.least_widths(_LIST)
        if _width(least) > width:
            least = self.least_widths()
        while _width(widths) > width and widths != least:
            room = [have - need for have, need in zip(widths, least, strict=True)]
            widest = max((w for w, r in zip(widths, room, strict=True) if r), default=0)
            widths[next(at for at, w in enumerate(widths) if w == widest and room[at])] -= 1
        rows = [[_fold(*pair) for pair in zip(row, widths, strict=True)] for row in self.rows]
        return Grid(self.names, rows)

    def _columns(self) -> list[tuple[str, ...]]:
        return list(zip(*([self.names, *self.rows]), strict=True))


def table_width() -> int | None:
    """The characters that a line of a table may have; ``None``: as many as it wants.

    Only a terminal has a limit.
    """
    context = click.get_current_context(silent=True)
    if not sys.stdout.isatty() or (context is not None and context.params.get("output")):
        return None
    return max(_LEAST, shutil.get_terminal_size().columns)


def fit(
    grid: Grid, width: int, beneath: Sequence[str] = (), repeated: int = 0
) -> tuple[list[Grid], list[str]]:
    """A table that is too wide as one that is not, and lines to print beneath it.

    In this order, until it fits: empty columns go; columns of ``beneath`` that say the same in
    every row are said in a line beneath; cells are folded. What is still too wide goes into further
    tables, which repeat the first ``repeated`` columns; where none is to be repeated, the columns
    of ``beneath``, then the last ones, are left out, and a line names them.
    """
    if grid.width <= width:
        return [grid], []
    if grid.rows:
        grid = grid.without(*(name for name in grid.names[1:] if not any(grid.column(name))))
    lines = []
    if grid.width > width and (same := [n for n in beneath if len(set(grid.column(n))) == 1]):
        lines.append(", ".join(f"{name} {grid.column(name)[0]}" for name in same))
        grid = grid.without(*same)
    if repeated:
        return [part.folded(width) for part in _parts(grid, width, repeated)], lines
    kept = _kept(grid, width, beneath)
    if left_out := [name for at, name in enumerate(grid.names) if at not in kept]:
        told = f"not shown: {', '.join(left_out)} (a wider terminal or a pipe has them)"
        lines += textwrap.wrap(told, width)
    return [grid.only(kept).folded(width)], lines


def _kept(grid: Grid, width: int, beneath: Sequence[str]) -> list[int]:
    """The places of the columns for which there is room, once their cells are folded."""
    least, kept = grid.least_widths(), list(range(len(grid.names)))
    first = [grid.names.index(name) for name in reversed(beneath) if name in grid.names]
    for at in dict.fromkeys((*first, *reversed(kept[1:]))):
        if _width([least[place] for place in kept]) <= width:
            break
        kept.remove(at)
    return kept


def _parts(grid: Grid, width: int, repeated: int) -> list[Grid]:
    """The table in parts of at most some characters, the first columns repeated in each."""
    widths, key = grid.widths, list(range(repeated))
    parts = [[*key]]
    for at in range(repeated, len(grid.names)):
        if len(parts[-1]) > repeated and _width([widths[n] for n in (*parts[-1], at)]) > width:
            parts.append([*key])
        parts[-1].append(at)
    return [grid.only(places) for places in parts]


def _width(widths: Sequence[int]) -> int:
    return sum(widths) + _GAP * (len(widths) - 1)


def _longest(cell: str) -> int:
    return max(map(len, cell.split("\n")))


def _longest_part(cell: str, between: str | None) -> int:
    """Characters of the longest part of a list, with its comma, or the longest word."""
    parts = cell.split(between)
    return max(map(len, parts), default=0) + (between is not None and len(parts) > 1)


def _fold(cell: str, width: int) -> str:
    """A cell on several lines, broken between the parts of a list where that does, else words."""
    if len(cell) <= width:
        return cell
    parts = (p.replace(" ", _TIED) if len(p) < width else p for p in cell.split(_LIST))
    lines = textwrap.wrap(_LIST.join(parts), width, break_on_hyphens=False)
    return "\n".join(lines).replace(_TIED, " ") or cell
