"""Whether the sizes that a binary Spark-DSG graph declares fit the bytes that are there.

``spark_dsg`` makes room for as many values as a graph declares before it looks for them, so that a
few forged bytes take gigabytes. `check_graph` walks over a graph as the decoder would, without
decoding it, and refuses what does not fit. It knows the layouts of spark_dsg 1.0.2 to 1.1.3.

A graph is a run of values. A number is a byte for its type, then the number, little-endian. A list
is the byte ``DD``, the number of its entries in four bytes, then the entries; so is a text, whose
entries are plain bytes. Vectors of three are written without a list around them.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
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
_BOOL, _U8, _F32, _I32, _U32, _F64, _I64, _U64 = 1, 2, 5, 5, 5, 9, 9, 9
_LIST = 5
_TURN = _LIST + 4 * _F64
_LAYER = _LIST + _I64 + _U32
_VERTEX = 3 * _LIST + 3 * _I32 + 3 * _F64 + _U64  # and a label, which may be absent

_LISTS = b"\xdd\xdb"
_BEGIN, _END, _NONE, _TRUE = 0x00, 0x01, 0xC0, 0xC3
_COUNT, _SHAPE, _INTEGER = struct.Struct("<BI"), struct.Struct("<BqBq"), 0xD3
_NO_METADATA = b"\xdd\2\0\0\0{}"
_IDENTIFIER = b"SPARK_DSG"
_FIRST_READABLE = (1, 0, 2)  # spark_dsg refuses older files itself
_LAST_KNOWN = (1, 1, 3)
_MOST_TYPES = 256  # a node's type is one byte
# A run is found at a glance: so many entries at most, each with a text of so many bytes at most.
_RUN, _SHORT = 256, 15

_TEXT = List(1)


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


def check_graph(data: bytes, version: Version | None) -> None:
    """Refuse a graph that declares more than it holds.

    Parameters
    ----------
    data : a file's content, or a message
    version : the ``spark_dsg`` that wrote a message; ``None`` for a file, which says so itself

    Raises
    ------
    MalformedError
        A size does not fit, a node is of an unknown type, metadata is no JSON or nested too deeply.
    """
    at = 0
    try:
        if version is None:
            at, version = _file_version(data)
        if version >= _FIRST_READABLE:
            _check(data, at, version)
    except (IndexError, struct.error, MalformedError) as error:
        said = str(error) if isinstance(error, MalformedError) else "it ends within a value"
        if version is not None and version > _LAST_KNOWN:
            wrote = ".".join(map(str, version))
            said = f"{said}; spark_dsg {wrote} wrote it, and its layout may be a new one"
        raise MalformedError(said) from error


def _file_version(data: bytes) -> tuple[int, Version]:
    """Where the graph begins in a file, and the version that wrote it."""
    if data[:1] != _LISTS[:1]:
        return 0, (1, 0, 0)
    identifier, at = _text(data, 0)
    if identifier != _IDENTIFIER:
        return 0, (1, 0, 0)
    _, at = _text(data, at)  # the project
    return at + 3 * _U8, (data[at + 1], data[at + 3], data[at + 5])


def _check(data: bytes, at: int, version: Version) -> None:
    layers = List(_LAYER if version >= (1, 1, 2) else _I64)
    at = _walk(data, at, Layout.of(layers))
    node_types, at = _texts(data, at)
    edge_types, at = _texts(data, at)
    if version >= (1, 1, 0):
        layer = _LAYER if version >= (1, 1, 1) else _I64
        at = _walk(data, at, Layout.of(_each(Layout.of(_TEXT, layer), _LIST + layer)))
    metadata = _metadata_of(version)
    at = _walk(data, at, Layout.of(*metadata))
    layouts = _layouts(version)
    nodes = [layouts.get(name) for name in node_types]
    stamped = version < (1, 1, 0)  # such graphs have two lists of nodes
    for _ in range(2 if stamped else 1):
        at = _entries(data, at, _LIST + _I64 + _U64 + (0 if stamped else _U32), nodes, stamped)
    edge = Layout.of(*metadata, _BOOL + _F64)
    edges = [edge if name == b"EdgeAttributes" else None for name in edge_types]
    at = _entries(data, at, _LIST + 2 * _U64, edges)
    if data[at : at + 1] == bytes([_TRUE]):
        _walk(data, at + 1, Layout.of(*_MESH))


def _walk(data: bytes, at: int, layout: Layout) -> int:
    """Step over what is laid out so; returns its end."""
    size = len(data)
    for before, (each, inside, usual, usual_size) in layout.lists:
        at += before
        if data.startswith(usual, at):
            at += usual_size
            continue
        if data[at] not in _LISTS:
            raise MalformedError(f"no list at byte {at}")
        count = int.from_bytes(data[at + 1 : at + 5], "little")
        at += _LIST
        if count * each > size - at:
            raise MalformedError(f"it declares {count} values at byte {at} and ends before them")
        at = inside(data, at, count) if inside else at + count * each
    return at + layout.rest


def _text(data: bytes, at: int) -> tuple[bytes, int]:
    end = _walk(data, at, Layout.of(_TEXT))
    return data[at + _LIST : end], end


def _texts(data: bytes, at: int) -> tuple[list[bytes], int]:
    found: list[bytes] = []

    def inside(data: bytes, at: int, count: int) -> int:
        if count > _MOST_TYPES:
            raise MalformedError(f"{count} types of nodes or edges")
        for _ in range(count):
            text, at = _text(data, at)
            found.append(text)
        return at

    return found, _walk(data, at, Layout.of(List(_LIST, inside)))


def _entries(
    data: bytes, at: int, head: int, layouts: Sequence[Layout | None], stamped: bool = False
) -> int:
    """Step over nodes or edges: a head, with a time where ``stamped``, the number of a type, and
    what that type has."""
    if data[at] != _BEGIN:
        raise MalformedError(f"neither nodes nor edges begin at byte {at}")
    at += 1
    runs: dict[int, re.Pattern[bytes]] = {}
    kind = 0
    while data[at] != _END:
        if kind in runs and (run := runs[kind].match(data, at)):
            at = run.end()
            continue
        at += head
        if stamped:
            at += 1 if data[at] == _NONE else _I64
        kind = data[at + 1]
        layout = layouts[kind] if kind < len(layouts) else None
        if layout is None:
            raise MalformedError(f"a node or an edge of an unknown type at byte {at}")
        at = _walk(data, at + _U8, layout)
        if kind not in runs and not stamped:
            runs[kind] = _run(layout, head, kind)
    return at + 1


@lru_cache(maxsize=64)
def _run(layout: Layout, head: int, kind: int) -> re.Pattern[bytes]:
    """Entries of one type that hold nothing but the usual in their lists: what `_entries` would
    step over one by one."""
    short = (rb"\x%02x\0{3}.{%d}" % (length, length) for length in range(_SHORT + 1))
    text = rb"\xdd(?:%s)" % b"|".join(short)
    parts = [rb"[^\x%02x].{%d}\x%02x" % (_END, head + _U8 - 2, kind)]
    for before, (each, inside, usual, size) in layout.lists:
        usual_list = re.escape(usual) + b".{%d}" % (size - len(usual))
        parts += [b".{%d}" % before, text if (each, inside) == (1, None) else usual_list]
    entry = b"".join([*parts, b".{%d}" % layout.rest])
    return re.compile(b"(?:%s){1,%d}" % (entry, _RUN), re.DOTALL)


def _each(layout: Layout, least: int) -> List:
    """A list of entries that are all laid out so, in ``least`` bytes or more."""

    def inside(data: bytes, at: int, count: int) -> int:
        for _ in range(count):
            at = _walk(data, at, layout)
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
        return at + 2 * _I64 + size * each

    high, wide = rows or 0, columns or (0 if rows is None else 1)
    usual = _COUNT.pack(_LISTS[0], high * wide + 2) + _SHAPE.pack(_INTEGER, high, _INTEGER, wide)
    return List(min(each, _I64), inside, usual, len(usual) + high * wide * each)


def _vertices(data: bytes, at: int, count: int) -> int:
    for _ in range(count):
        at += _VERTEX
        at += 1 if data[at] == _NONE else _U32
    return at


def _metadata(data: bytes, at: int, count: int) -> int:
    if count > LINE_BYTES:
        raise MalformedError(f"metadata of more than {LINE_BYTES >> 20} MB")
    try:
        json_value(data[at : at + count])
    except MalformedError as error:
        raise MalformedError(f"its metadata: {error}") from error
    return at + count


def _metadata_of(version: Version) -> Parts:
    return [List(1, _metadata, _NO_METADATA, len(_NO_METADATA))] if version >= (1, 0, 6) else []


_MESH: Parts = [
    4 * _BOOL,
    List(3 * _F32),  # points
    List(4 * _U8),  # colours
    List(_U64),  # times
    List(_U32),  # labels
    List(_U64),  # times first seen
    List(_LIST + 3 * _U64),  # faces
]


@cache
def _layouts(version: Version) -> Mapping[bytes, Layout]:
    """What nodes of each type hold."""
    flags = 2 * _BOOL if version >= (1, 0, 4) else _BOOL
    plain: Parts = [*_metadata_of(version), 3 * _F64 + _U64 + flags]
    colour = (4 if version > (1, 0, 2) else 3) * _U8
    box = _LIST + _I32 + (6 if version >= (1, 0, 3) else 9) * _F32
    feature = _matrix(_F32 if version > (1, 0, 4) else _F64)
    semantic: Parts = [*plain, _TEXT, colour + box, _matrix(_F32, 3, 3), _U32, feature]
    item: Parts = [*semantic, List(_U64), _BOOL + _TURN]
    connections: Parts = [List(_VERTEX + 1, _vertices), List(_U64), List(_U8), List(_U64)]
    frontier = 2 * _BOOL + 3 * _F64 + _TURN + _BOOL + _U64 + _BOOL * (version >= (1, 1, 3))
    square, pair = _matrix(_F64, 2, 2), _matrix(_F64, 2, 1)
    boundary: Parts = [List(3 * _F64), 3 * _F64, square, square, List(_U64)]
    pose = (_I64 if version >= (1, 1, 0) else 0) + _TURN + _U64
    track: Parts = [List(_U64), List(_U64), List(3 * _F32), List(_U64)]
    points = _each(Layout.of(List(3 * _F32)), _LIST)
    details = _each(Layout.of(_TEXT, List(_U64)), 2 * _LIST)
    likely = _each(Layout.of(_TEXT, _F64), _LIST + _F64)
    types: dict[bytes, Parts] = {
        b"NodeAttributes": plain,
        b"SemanticNodeAttributes": semantic,
        b"ObjectNodeAttributes": item,
        b"RoomNodeAttributes": [*semantic, likely],
        b"PlaceNodeAttributes": [*semantic, _F64 + _U32, *connections, frontier],
        b"Place2dNodeAttributes": [*semantic, *boundary, *connections, 2 * _BOOL],
        b"AgentNodeAttributes": [*plain, pose, _matrix(_U32, None, 1), _matrix(_F32, None, 1)],
        b"KhronosObjectAttributes": [*item, *track, points, details, *_MESH],
        b"TraversabilityNodeAttributes": [*plain, 2 * _U64 + _F64, pair, pair, *4 * [List(_U8)]],
    }
    return {name: Layout.of(*parts) for name, parts in types.items()}
