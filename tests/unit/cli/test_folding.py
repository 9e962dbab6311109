"""Tables on a narrow terminal: nothing is cut in a name, and what is not there is named."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.cli.common import render
from roomtables.cli.folding import Grid, fit

ROOMS = Grid(
    ["room_id", "room", "probability", "objects", "unknown_objects", "rule", "source",
     "answered_by", "read_as"],
    [
        ["R(0)", "bathroom", "0.8489", "toilet, towel, sink", "", "query", "proxy", "table", ""],
        ["R(1)", "bedroom", "0.768", "bed, chest of drawers, lamp", "", "query", "proxy", "table",
         "tv = television, gas stove = stove, MicrowaveOven = microwave"],
    ],
)  # fmt: skip
BENEATH = ("rule", "source", "answered_by")


def lines(grid: Grid) -> list[str]:
    """The table's own lines: names, then each line of each row."""
    rows = [[cell.split("\n") for cell in row] for row in [grid.names, *grid.rows]]
    deepest = [max(map(len, row)) for row in rows]
    return [
        "  ".join(
            (cell[at] if at < len(cell) else "").ljust(width)
            for cell, width in zip(row, grid.widths, strict=True)
        )
        for row, deep in zip(rows, deepest, strict=True)
        for at in range(deep)
    ]


@pytest.mark.parametrize("width", [95, 100, 120])
def test_a_table_of_rooms_fits_and_loses_nothing(width: int) -> None:
    (grid,), beneath = fit(ROOMS, width, BENEATH)
    assert max(map(len, lines(grid))) <= width
    assert list(grid.names) == ["room_id", "room", "probability", "objects", "read_as"]
    assert beneath == ["rule query, source proxy, answered_by table"]
    folded = [cell.replace(",\n", ", ") for cell in grid.column("read_as")]
    assert folded == ROOMS.column("read_as")  # broken between the names of a list only


def test_what_has_room_is_left_alone() -> None:
    assert fit(ROOMS, ROOMS.width, BENEATH) == ([ROOMS], [])


def test_what_differs_from_row_to_row_is_not_said_beneath() -> None:
    rows = [[*ROOMS.rows[0]], [*ROOMS.rows[1]]]
    rows[1][5] = "pooled"
    (grid,), beneath = fit(Grid(ROOMS.names, rows), 90, BENEATH)
    assert grid.column("rule") == ["query", "pooled"]
    assert beneath == ["source proxy, answered_by table"]


def test_columns_that_have_no_room_at_all_are_named() -> None:
    grid = Grid([f"column_{n:02}" for n in range(20)], [[str(n) for n in range(20)]] * 2)
    (shown,), said = fit(grid, 80)
    assert list(shown.names) == [f"column_{n:02}" for n in range(6)]
    assert said[0].startswith("not shown: column_06, column_07")
    assert " ".join(said).count("column_") == 14
    assert max(map(len, said)) <= 80


def test_columns_go_on_in_a_further_table_where_the_first_are_repeated() -> None:
    names = ["room", "rooms", *(f"calibrated:source_{n}" for n in range(6))]
    parts, beneath = fit(Grid(names, [["bathroom", "12", *"abcdef"]]), 80, repeated=2)
    assert beneath == []
    assert [list(part.names[:2]) for part in parts] == [["room", "rooms"]] * len(parts)
    assert [name for part in parts for name in part.names[2:]] == names[2:]
    assert all(part.width <= 80 for part in parts)


WORDS = st.text("abc -:,_", max_size=50)
GRIDS = st.integers(1, 9).flatmap(
    lambda columns: st.tuples(
        st.lists(st.text("abc_", min_size=1, max_size=16), min_size=columns, max_size=columns,
                 unique=True),
        st.lists(st.lists(WORDS, min_size=columns, max_size=columns), max_size=4),
    )
)  # fmt: skip


@given(GRIDS, st.integers(40, 140), st.booleans())
def test_any_table_fits_and_says_what_it_lacks(
    drawn: tuple[list[str], list[list[str]]], width: int, repeat: bool
) -> None:
    grid = Grid(*drawn)
    parts, said = fit(grid, width, tuple(grid.names[-2:]), int(repeat))
    shown = [name for part in parts for name in part.names]
    assert all(part.width <= width for part in parts)
    assert set(shown) <= set(grid.names)  # no name is broken or cut
    for name in set(grid.names) - set(shown):
        empty = not any(grid.column(name)) and grid.rows
        assert empty or name in " ".join(said)
    for part in parts:
        for name in part.names:
            cells = ["".join(cell.split()) for cell in part.column(name)]
            assert cells == ["".join(cell.split()) for cell in grid.column(name)]


def test_into_a_pipe_every_row_is_one_whole_line() -> None:
    rows = [dict(zip(ROOMS.names, row, strict=True)) for row in ROOMS.rows]
    text = render(rows, "table", beneath=BENEATH)
    assert len(text.splitlines()) == 2 + len(rows)
    assert all(cell in text for row in ROOMS.rows for cell in row)
