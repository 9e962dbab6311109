"""Whether the sizes that a binary Spark-DSG graph declares fit the bytes that are there.

``spark_dsg`` makes room for as many values as a graph declares before it looks for them, so that a
few forged bytes take gigabytes. `check_graph` walks over a graph as the decoder would, without
decoding it, and refuses what does not fit. It knows the layouts of spark_dsg 1.0.2 to 1.1.3.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

from roomtables.limits import MalformedError
from roomtables.scenes.dsg_layout import (
    BOOL,
    F64,
    I64,
    LAYER,
    LIST,
    LISTS,
    MESH,
    NONE,
    TEXT,
    U8,
    U32,
    U64,
    Layout,
    List,
    Version,
    each_of,
    layouts_of,
    metadata_of,
    walk,
)

_BEGIN, _END, _TRUE = 0x00, 0x01, 0xC3
_IDENTIFIER = b"SPARK_DSG"
_FIRST_READABLE = (1, 0, 2)  # spark_dsg refuses older files itself
_LAST_KNOWN = (1, 1, 3)
_MOST_TYPES = 256  # a node's type is one byte
# A run is found at a glance: so many entries at most, each with a text of so many bytes at most.
_RUN, _SHORT = 256, 15
_OBJECTS = frozenset({b"ObjectNodeAttributes", b"KhronosObjectAttributes"})
_LISTS_BEFORE_LABEL = 3  # of an object's attributes
_PLACE = struct.Struct("<qxQxI")  # a node's layer, id and partition


class Span(NamedTuple):
    """Where entries of one type are in a graph: one, or several of a `_run`."""

    kind: int
    start: int
    end: int
    is_run: bool


class CheckedGraph(NamedTuple):
    """What `check_graph` saw of a graph's nodes: where they are, and the layouts of objects, by
    type."""

    data: bytes
    head: int = 0
    objects: Mapping[int, Layout] = MappingProxyType({})
    spans: Sequence[Span] = ()

    def object_labels(self, layer: int, partition: int) -> dict[int, int]:
        """The semantic labels of a layer's objects, by id.

        Objects with metadata or a long name are left out; there are none where ids repeat.
        """
        patterns = {kind: _object(of, self.head, kind) for kind, of in self.objects.items()}
        found: list[tuple[bytes, ...]] = []
        for kind, start, end, is_run in self.spans:
            if kind in patterns:
                if is_run:
                    found += patterns[kind].findall(self.data, start, end)
                elif match := patterns[kind].match(self.data, start, end):
                    found.append(match.groups())
        wanted = []
        for place, label in found:
            in_layer, node, in_partition = _PLACE.unpack(place)
            if in_layer == layer and in_partition == partition:
                wanted.append((node, label))
        labels = {node: int.from_bytes(label, "little") for node, label in wanted}
        return labels if len(labels) == len(wanted) else {}


def check_graph(data: bytes, version: Version | None) -> CheckedGraph:
    """Refuse a graph that declares more than it holds; else, where its nodes are.

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
            return _check(data, at, version)
    except (IndexError, struct.error, MalformedError) as error:
        said = str(error) if isinstance(error, MalformedError) else "it ends within a value"
        if version is not None and version > _LAST_KNOWN:
            wrote = ".".join(map(str, version))
            said = f"{said}; spark_dsg {wrote} wrote it, and its layout may be a new one"
        raise MalformedError(said) from error
    return CheckedGraph(data)


def _file_version(data: bytes) -> tuple[int, Version]:
    """Where the graph begins in a file, and the version that wrote it."""
    if data[:1] != LISTS[:1]:
        return 0, (1, 0, 0)
    identifier, at = _text(data, 0)
    if identifier != _IDENTIFIER:
        return 0, (1, 0, 0)
    _, at = _text(data, at)  # the project
    return at + 3 * U8, (data[at + 1], data[at + 3], data[at + 5])


def _check(data: bytes, at: int, version: Version) -> CheckedGraph:
    layers = List(LAYER if version >= (1, 1, 2) else I64)
    at = walk(data, at, Layout.of(layers))
    node_types, at = _texts(data, at)
    edge_types, at = _texts(data, at)
    if version >= (1, 1, 0):
        layer = LAYER if version >= (1, 1, 1) else I64
        at = walk(data, at, Layout.of(each_of(Layout.of(TEXT, layer), LIST + layer)))
    metadata = metadata_of(version)
    at = walk(data, at, Layout.of(*metadata))
    layouts = layouts_of(version)
    nodes = [layouts.get(name) for name in node_types]
    stamped = version < (1, 1, 0)  # such graphs have two lists of nodes
    head, spans = LIST + I64 + U64 + (0 if stamped else U32), list[Span]()
    for _ in range(2 if stamped else 1):
        at = _entries(data, at, head, nodes, spans, stamped)
    edge = Layout.of(*metadata, BOOL + F64)
    edges = [edge if name == b"EdgeAttributes" else None for name in edge_types]
    at = _entries(data, at, LIST + 2 * U64, edges, [])
    if data[at : at + 1] == bytes([_TRUE]):
        walk(data, at + 1, Layout.of(*MESH))
    if stamped:
        return CheckedGraph(data)
    named = zip(node_types, nodes, strict=True)
    objects = {at: of for at, (name, of) in enumerate(named) if of and name in _OBJECTS}
    return CheckedGraph(data, head, objects, spans)


def _text(data: bytes, at: int) -> tuple[bytes, int]:
    end = walk(data, at, Layout.of(TEXT))
    return data[at + LIST : end], end


def _texts(data: bytes, at: int) -> tuple[list[bytes], int]:
    found: list[bytes] = []

    def inside(data: bytes, at: int, count: int) -> int:
        if count > _MOST_TYPES:
            raise MalformedError(f"{count} types of nodes or edges")
        for _ in range(count):
            text, at = _text(data, at)
            found.append(text)
        return at

    return found, walk(data, at, Layout.of(List(LIST, inside)))


def _entries(
    data: bytes,
    at: int,
    head: int,
    layouts: Sequence[Layout | None],
    spans: list[Span],
    stamped: bool = False,
) -> int:
    """Step over nodes or edges: a head, with a time where ``stamped``, the number of a type, and
    what that type has. Adds where they are to ``spans``."""
    if data[at] != _BEGIN:
        raise MalformedError(f"neither nodes nor edges begin at byte {at}")
    at += 1
    runs: dict[int, re.Pattern[bytes]] = {}
    while data[at] != _END:
        start = at
        at += head
        if stamped:
            at += 1 if data[at] == NONE else I64
        kind = data[at + 1]
        layout = layouts[kind] if kind < len(layouts) else None
        if layout is None:
            raise MalformedError(f"a node or an edge of an unknown type at byte {at}")
        if kind not in runs:
            runs[kind] = _run(layout, head, kind)
        run = None if stamped else runs[kind].match(data, start)
        at = run.end() if run else walk(data, at + U8, layout)
        spans.append(Span(kind, start, at, run is not None))
    return at + 1


@lru_cache(maxsize=64)
def _run(layout: Layout, head: int, kind: int) -> re.Pattern[bytes]:
    """Entries of one type that hold nothing but the usual in their lists: what `_entries` would
    step over one by one."""
    begin = rb"[^\x%02x].{%d}\x%02x" % (_END, head + U8 - 2, kind)
    entry = b"".join([begin, *map(_usual, layout.lists), b".{%d}" % layout.rest])
    return re.compile(b"(?:%s){1,%d}" % (entry, _RUN), re.DOTALL)


@lru_cache(maxsize=64)
def _object(layout: Layout, head: int, kind: int) -> re.Pattern[bytes]:
    """An object of a `_run`, or another down to its label: its `_PLACE` and its label."""
    begin = rb".{%d}.(.{%d}).\x%02x" % (LIST, head - LIST - 1, kind)
    first, last = layout.lists[:_LISTS_BEFORE_LABEL], layout.lists[_LISTS_BEFORE_LABEL:]
    label, feature = last[0]
    rest = b"".join([*map(_usual, [(0, feature), *last[1:]]), b".{%d}" % layout.rest])
    parts = [begin, *map(_usual, first), b".(.{%d})" % (label - 1), b"(?:%s)?" % rest]
    return re.compile(b"".join(parts), re.DOTALL)


def _usual(part: tuple[int, List]) -> bytes:
    """A pattern of a list that holds the usual, or of a short text, with the bytes before it."""
    before, (each, inside, usual, size) = part
    listed = re.escape(usual) + b".{%d}" % (size - len(usual))
    if (each, inside) == (TEXT.each, TEXT.inside):
        short = (rb"\x%02x\0{3}.{%d}" % (length, length) for length in range(_SHORT + 1))
        listed = rb"\xdd(?:%s)" % b"|".join(short)
    return b".{%d}" % before + listed
