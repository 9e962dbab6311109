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
from itertools import chain
from typing import NamedTuple

from roomtables.limits import MalformedError
from roomtables.scenes.dsg_layout import (
    BOOL,
    F64,
    FEATURE,
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
    layouts_of,
    list_spans,
    metadata_of,
    walk,
)

_BEGIN, _END, _TRUE = 0x00, 0x01, 0xC3
_IDENTIFIER = b"SPARK_DSG"
_FIRST_READABLE = (1, 0, 2)  # spark_dsg refuses older files itself
_LAST_KNOWN = (1, 1, 3)
_MOST_NAMES = 256  # of layers, and of types: a node's type is one byte
# A run is found at a glance: so many entries at most, each with a text of so many bytes at most.
_RUN, _SHORT = 256, 15
_LAYER_KEY = struct.Struct("<xqxI")
LABEL = 4  # bytes of a node's label, just before its list `FEATURE`
# What is looked for in entries, see `_entry`.
_HEADS, _LABELS, _LISTS = "heads", "heads and labels", "lists"


class Span(NamedTuple):
    """Where entries of one type are in a graph: one, or several of a `_run`."""

    kind: int
    start: int
    end: int
    is_run: bool


class Entries(NamedTuple):
    """A graph's nodes or edges: the bytes before each one's type, the types, and where they are."""

    head: int
    types: Sequence[bytes]
    layouts: Sequence[Layout | None]
    spans: list[Span]

    def heads(self, data: bytes, span: Span) -> list[bytes]:
        """What stands before the types of the entries of a span, without the header of its list."""
        if span.is_run:
            return self._pattern(span, _HEADS).findall(data, span.start, span.end)
        return [data[span.start + LIST : span.start + self.head]]

    def heads_and_labels(self, data: bytes, span: Span) -> list[tuple[bytes, bytes]]:
        """The same of semantic nodes, each with its label in four bytes."""
        if span.is_run:
            return self._pattern(span, _LABELS).findall(data, span.start, span.end)
        at = self.list_spans(data, span)[0][FEATURE][0]
        return [(self.heads(data, span)[0], data[at - LABEL : at])]

    def list_spans(self, data: bytes, span: Span) -> list[Sequence[tuple[int, int]]]:
        """Where the lists of the entries of a span begin and end."""
        if span.is_run:
            found = self._pattern(span, _LISTS).finditer(data, span.start, span.end)
            return [[entry.span(at) for at in range(1, entry.re.groups + 1)] for entry in found]
        return [list_spans(data, span.start + self.head + U8, self._layout(span))]

    def _layout(self, span: Span) -> Layout:
        layout = self.layouts[span.kind]
        assert layout is not None  # else the graph would have been refused
        return layout

    def _pattern(self, span: Span, groups: str) -> re.Pattern[bytes]:
        return _entry(self._layout(span), self.head, span.kind, groups)


class CheckedGraph(NamedTuple):
    """A graph whose sizes fit, and where its parts are.

    Attributes
    ----------
    data : the graph
    metadata : where its metadata begins and ends
    layers : the numbers of each layer and of its partition, by name
    nodes, edges
    end : where the edges end, and with them all but the mesh
    """

    data: bytes
    metadata: tuple[int, int]
    layers: Mapping[str, tuple[int, int]]
    nodes: Entries
    edges: Entries
    end: int


def check_graph(data: bytes, version: Version | None) -> CheckedGraph:
    """Refuse a graph that declares more than it holds; else, where its parts are.

    Parameters
    ----------
    data : a file's content, or a message
    version : the ``spark_dsg`` that wrote a message; ``None`` for a file, which says so itself

    Raises
    ------
    MalformedError
        A size does not fit, a node is of an unknown type, metadata is no JSON or nested too deeply,
        or the graph is older than all that ``spark_dsg`` reads.
    """
    at = 0
    try:
        if version is None:
            at, version = _file_version(data)
        if version < _FIRST_READABLE:
            raise MalformedError(f"it is older than spark_dsg {_shown(_FIRST_READABLE)}")
        return _check(data, at, version)
    except (IndexError, struct.error, MalformedError) as error:
        said = str(error) if isinstance(error, MalformedError) else "it ends within a value"
        if version is not None and version > _LAST_KNOWN:
            wrote = f"spark_dsg {_shown(version)} wrote it"
            said = f"{said}; {wrote}, and its layout may be a new one"
        raise MalformedError(said) from error


def _shown(version: Version) -> str:
    return ".".join(map(str, version))


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
    node_types, at = _names(data, at, 0)
    edge_types, at = _names(data, at, 0)
    layer_names: list[tuple[bytes, int]] = []
    if version >= (1, 1, 0):
        layer_names, at = _names(data, at, LAYER if version >= (1, 1, 1) else I64)
    metadata = at
    at = walk(data, at, Layout.of(*metadata_of(version)))
    stamped = version < (1, 1, 0)  # such graphs have two lists of nodes
    head, layouts = LIST + I64 + U64 + (0 if stamped else U32), layouts_of(version)
    types = [name for name, _ in node_types]
    nodes = Entries(head, types, [layouts.get(name) for name in types], [])
    edge, types = Layout.of(*metadata_of(version), BOOL + F64), [name for name, _ in edge_types]
    known = [edge if name == b"EdgeAttributes" else None for name in types]
    edges = Entries(LIST + 2 * U64, types, known, [])
    begin = at
    for _ in range(2 if stamped else 1):
        at = _step_over(data, at, nodes, stamped)
    at = end = _step_over(data, at, edges)
    if data[at : at + 1] == bytes([_TRUE]):
        walk(data, at + 1, Layout.of(*MESH))
    numbers = {_decoded(name): _layer(data, at) for name, at in layer_names}
    return CheckedGraph(data, (metadata, begin), numbers, nodes, edges, end)


def _text(data: bytes, at: int) -> tuple[bytes, int]:
    end = walk(data, at, Layout.of(TEXT))
    return data[at + LIST : end], end


def _decoded(name: bytes) -> str:
    return name.decode("utf-8", "replace")


def _layer(data: bytes, at: int) -> tuple[int, int]:
    """The numbers of a layer and of its partition."""
    if data[at] != LISTS[0]:
        return int.from_bytes(data[at + 1 : at + I64], "little", signed=True), 0
    layer, partition = _LAYER_KEY.unpack_from(data, at + LIST)
    return layer, partition


def _names(data: bytes, at: int, behind: int) -> tuple[list[tuple[bytes, int]], int]:
    """A list of names, each with as many bytes behind it, and where those are; and its end."""
    found: list[tuple[bytes, int]] = []

    def inside(data: bytes, at: int, count: int) -> int:
        if count > _MOST_NAMES:
            raise MalformedError(f"{count} types of nodes or edges, or names of layers")
        for _ in range(count):
            text, at = _text(data, at)
            found.append((text, at))
            at += behind
        return at

    return found, walk(data, at, Layout.of(List(LIST + behind, inside)))


def _step_over(data: bytes, at: int, entries: Entries, stamped: bool = False) -> int:
    """Step over nodes or edges: a head, with a time where ``stamped``, the number of a type, and
    what that type has. Notes where they are."""
    if data[at] != _BEGIN:
        raise MalformedError(f"neither nodes nor edges begin at byte {at}")
    at += 1
    runs: dict[int, re.Pattern[bytes]] = {}
    while data[at] != _END:
        start = at
        at += entries.head
        if stamped:
            at += 1 if data[at] == NONE else I64
        kind = data[at + 1]
        layout = entries.layouts[kind] if kind < len(entries.layouts) else None
        if layout is None:
            raise MalformedError(f"a node or an edge of an unknown type at byte {at}")
        if kind not in runs:
            runs[kind] = _run(layout, entries.head, kind)
        run = None if stamped else runs[kind].match(data, start)
        at = run.end() if run else walk(data, at + U8, layout)
        entries.spans.append(Span(kind, start, at, run is not None))
    return at + 1


@lru_cache(maxsize=64)
def _run(layout: Layout, head: int, kind: int) -> re.Pattern[bytes]:
    """Entries of one type that hold nothing but the usual in their lists: what `_step_over` would
    step over one by one."""
    entry = _entry(layout, head, kind).pattern
    return re.compile(b"(?:%s){1,%d}" % (entry, _RUN), re.DOTALL)


@lru_cache(maxsize=64)
def _entry(layout: Layout, head: int, kind: int, groups: str = "") -> re.Pattern[bytes]:
    """One of a `_run`, with its head, its head and label, or its lists as groups."""
    begin, own = rb"[^\x%02x].{%d}" % (_END, LIST - 1), b".{%d}" % (head - LIST)
    lists = [(b".{%d}" % before, _usual(of)) for before, of in layout.lists]
    if groups in (_HEADS, _LABELS):
        own = b"(%s)" % own
    if groups == _LABELS:
        label = b".{%d}(.{%d})" % (layout.lists[FEATURE][0] - LABEL, LABEL)
        lists[FEATURE] = label, lists[FEATURE][1]
    if groups == _LISTS:
        lists = [(before, b"(%s)" % of) for before, of in lists]
    parts = [begin, own, rb".\x%02x" % kind, *chain.from_iterable(lists), b".{%d}" % layout.rest]
    return re.compile(b"".join(parts), re.DOTALL)


def _usual(of: List) -> bytes:
    """A pattern of a list that holds the usual, or of a short text."""
    each, inside, usual, size = of
    if (each, inside) == (TEXT.each, TEXT.inside):
        short = (rb"\x%02x\0{3}.{%d}" % (length, length) for length in range(_SHORT + 1))
        return rb"\xdd(?:%s)" % b"|".join(short)
    return re.escape(usual) + b".{%d}" % (size - len(usual))
