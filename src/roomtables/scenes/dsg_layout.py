"""How spark_dsg 1.0.2 to 1.1.3 lay out what a binary graph holds, and how to step over it.

A graph is a run of values. A number is a byte for its type, then the number, little-endian. A list
is the byte ``DD``, the number of its entries in four bytes, then the entries; so is a text, whose
entries are plain bytes. Vectors of three are written without a list around them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import NamedTuple

from roomtables.limits import LINE_BYTES, MalformedError, json_value

Version = tuple[int, ...]
# Steps over a list's entries: from the graph, where they begin and how many they are, to their end.
Inside = Callable[[bytes, int, int], int]


class List(NamedTuple):
    """A list whose entries take ``each`` bytes; or that many at least, where ``inside`` steps over
    them. One that begins with ``usual`` takes ``usual_size`` bytes: that is seen at a glance."""

    each: int
    inside: Inside | None = None
    usual: bytes = b"\xdd\0\0\0\0"
    usual_size: int = 5


Parts = list[int | List]

# Bytes of numbers with their type, of a list's own header, and of a turn (a list of four).
BOOL, U8, F32, I32, U32, F64, I64, U64 = 1, 2, 5, 5, 5, 9, 9, 9
LIST = 5
_TURN = LIST + 4 * F64
LAYER = LIST + I64 + U32
_VERTEX = 3 * LIST + 3 * I32 + 3 * F64 + U64  # and a label, which may be absent

LISTS = b"\xdd\xdb"
NONE = 0xC0
_COUNT, _SHAPE, _INTEGER = struct.Struct("<BI"), struct.Struct("<BqBq"), 0xD3
_NO_METADATA = b"\xdd\2\0\0\0{}"

TEXT = List(1)


class Layout(NamedTuple):
    """Lists, each with the bytes before it, and the bytes behind the last."""

    lists: tuple[tuple[int, List], ...]
    rest: int

    @classmethod
    def of(cls, *parts: int | List) -> Layout:
        """The layout of what comes one after the other: numbers of bytes, and lists."""
        lists: list[tuple[int, List]] = []
        before = 0
        for part in parts:
            if isinstance(part, int):
                before += part
            else:
                lists.append((before, part))
                before = 0
        return cls(tuple(lists), before)


def walk(data: bytes, at: int, layout: Layout) -> int:
    """Step over what is laid out so; returns its end."""
    size = len(data)
    for before, (each, inside, usual, usual_size) in layout.lists:
        at += before
        if data.startswith(usual, at):
            at += usual_size
            continue
        if data[at] not in LISTS:
            raise MalformedError(f"no list at byte {at}")
        count = int.from_bytes(data[at + 1 : at + 5], "little")
        at += LIST
        if count * each > size - at:
            raise MalformedError(f"it declares {count} values at byte {at} and ends before them")
        at = inside(data, at, count) if inside else at + count * each
    return at + layout.rest


def list_spans(data: bytes, at: int, layout: Layout) -> list[tuple[int, int]]:
    """Where each of the lists begins and ends in what is laid out so."""
    spans = []
    for part in layout.lists:
        end = walk(data, at, Layout((part,), 0))
        spans.append((at + part[0], end))
        at = end
    return spans


def each_of(layout: Layout, least: int) -> List:
    """A list of entries that are all laid out so, in ``least`` bytes or more."""

    def inside(data: bytes, at: int, count: int) -> int:
        for _ in range(count):
            at = walk(data, at, layout)
        return at

    return List(least, inside)


def _matrix(each: int, rows: int | None = None, columns: int | None = None) -> List:
    """The numbers of rows and columns, then the entries; their numbers where the type fixes them.

    The list's length counts those two numbers as well.
    """

    def inside(data: bytes, at: int, count: int) -> int:
        found: tuple[int, int, int, int] = _SHAPE.unpack_from(data, at)
        size = found[1] * found[3]
        fits = rows in (None, found[1]) and columns in (None, found[3])
        if not fits or not 0 <= found[1] <= count or found[3] < 0 or size + 2 != count:
            raise MalformedError(f"a matrix of {found[1]} by {found[3]} in {count} values")
        return at + 2 * I64 + size * each

    high, wide = rows or 0, columns or (0 if rows is None else 1)
    usual = _COUNT.pack(LISTS[0], high * wide + 2) + _SHAPE.pack(_INTEGER, high, _INTEGER, wide)
    return List(min(each, I64), inside, usual, len(usual) + high * wide * each)


def _vertices(data: bytes, at: int, count: int) -> int:
    for _ in range(count):
        at += _VERTEX
        at += 1 if data[at] == NONE else U32
    return at


def _metadata(data: bytes, at: int, count: int) -> int:
    if count > LINE_BYTES:
        raise MalformedError(f"metadata of more than {LINE_BYTES >> 20} MB")
    try:
        json_value(data[at : at + count])
    except MalformedError as error:
        raise MalformedError(f"its metadata: {error}") from error
    return at + count


def metadata_of(version: Version) -> Parts:
    return [List(1, _metadata, _NO_METADATA, len(_NO_METADATA))] if version >= (1, 0, 6) else []


MESH: Parts = [
    4 * BOOL,
    List(3 * F32),  # points
    List(4 * U8),  # colours
    List(U64),  # times
    List(U32),  # labels
    List(U64),  # times first seen
    List(LIST + 3 * U64),  # faces
]


# The lists of a node, as `layouts_of` lays them out: those of all, of semantic ones, of rooms.
METADATA, NAME, FEATURE, PROBABILITIES = 0, 1, 3, 4


@cache
def layouts_of(version: Version) -> Mapping[bytes, Layout]:
    """What nodes of each type hold."""
    flags = 2 * BOOL if version >= (1, 0, 4) else BOOL
    plain: Parts = [*metadata_of(version), 3 * F64 + U64 + flags]
    colour = (4 if version > (1, 0, 2) else 3) * U8
    box = LIST + I32 + (6 if version >= (1, 0, 3) else 9) * F32
    feature = _matrix(F32 if version > (1, 0, 4) else F64)
    semantic: Parts = [*plain, TEXT, colour + box, _matrix(F32, 3, 3), U32, feature]
    item: Parts = [*semantic, List(U64), BOOL + _TURN]
    connections: Parts = [List(_VERTEX + 1, _vertices), List(U64), List(U8), List(U64)]
    frontier = 2 * BOOL + 3 * F64 + _TURN + BOOL + U64 + BOOL * (version >= (1, 1, 3))
    square, pair = _matrix(F64, 2, 2), _matrix(F64, 2, 1)
    boundary: Parts = [List(3 * F64), 3 * F64, square, square, List(U64)]
    pose = (I64 if version >= (1, 1, 0) else 0) + _TURN + U64
    track: Parts = [List(U64), List(U64), List(3 * F32), List(U64)]
    points = each_of(Layout.of(List(3 * F32)), LIST)
    details = each_of(Layout.of(TEXT, List(U64)), 2 * LIST)
    likely = each_of(Layout.of(TEXT, F64), LIST + F64)
    types: dict[bytes, Parts] = {
        b"NodeAttributes": plain,
        b"SemanticNodeAttributes": semantic,
        b"ObjectNodeAttributes": item,
        b"RoomNodeAttributes": [*semantic, likely],
        b"PlaceNodeAttributes": [*semantic, F64 + U32, *connections, frontier],
        b"Place2dNodeAttributes": [*semantic, *boundary, *connections, 2 * BOOL],
        b"AgentNodeAttributes": [*plain, pose, _matrix(U32, None, 1), _matrix(F32, None, 1)],
        b"KhronosObjectAttributes": [*item, *track, points, details, *MESH],
        b"TraversabilityNodeAttributes": [*plain, 2 * U64 + F64, pair, pair, *4 * [List(U8)]],
    }
    return {name: Layout.of(*parts) for name, parts in types.items()}
