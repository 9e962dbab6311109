"""The token trie: sequences that begin alike share nodes, and each node runs through a model once.

A leaf is not run, as its probability is read from its parent. The inner nodes in preorder are cut
into rows, and a row repeats the ancestors of its first node, which later nodes attend to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from roomtables.packing.sequences import FloatArray, Sequences, batches_by_length
from roomtables.packing.tokens import IntArray


@dataclass(frozen=True)
class Trie:
    """Inner nodes in preorder, and the edges (log probabilities) that are read from them.

    ``token``, ``depth``, ``parent`` and ``end`` have shape (inner nodes,); ``edge_source`` and
    ``edge_token`` have shape (edges,).
    """

    token: IntArray
    """Token id of each inner node."""
    depth: IntArray
    """Tokens before it: its position in the sentence."""
    parent: IntArray
    """The inner node before it, -1 for a first token."""
    end: IntArray
    """The first inner node after its subtree."""
    edge_source: IntArray
    """The inner node that each edge is read from, ascending."""
    edge_token: IntArray
    """The token whose log probability is read."""
    path: IntArray
    """Edges of each sequence, shape (sequences, longest - 1); -1 beyond its end, and for tokens
    that are not scored."""


def build_trie(sequences: Sequences) -> Trie:
    """The trie of sorted sequences of at least two tokens each."""
    matrix = sequences.matrix
    present = matrix >= 0
    shared = np.zeros_like(present)
    shared[1:] = np.logical_and.accumulate(matrix[1:] == matrix[:-1], axis=1)
    new = present & ~shared
    # Nodes are numbered row by row, which is preorder; a shared cell has the number above it.
    node = np.where(new, np.cumsum(new).reshape(new.shape) - 1, -1)
    node = np.maximum.accumulate(node, axis=0)
    depth = np.nonzero(new)[1]
    parent = np.where(depth > 0, np.roll(node, 1, axis=1)[new], -1)
    token = matrix[new]

    scored = present & (np.arange(matrix.shape[1]) >= sequences.first[:, None])

    inner = np.bincount(parent[parent >= 0], minlength=len(token)) > 0
    inner_number = np.cumsum(inner) - 1
    inner_parent = np.where(parent >= 0, inner_number[parent], -1)

    edges = np.flatnonzero(parent >= 0)
    edges = edges[np.argsort(inner_parent[edges], kind="stable")]
    edge_number = np.full(len(token), -1)
    edge_number[edges] = np.arange(len(edges))
    return Trie(
        token=token[inner],
        depth=depth[inner],
        parent=inner_parent[inner],
        end=_subtree_ends(inner_parent[inner], depth[inner]),
        edge_source=inner_parent[edges],
        edge_token=token[edges],
        path=np.where(scored, edge_number[node], -1)[:, 1:],
    )


def _subtree_ends(parent: IntArray, depth: IntArray) -> IntArray:
    """Where each node's subtree ends in preorder: itself and its descendants, deepest first."""
    size = np.ones(len(parent), np.int64)
    for level in range(depth.max(initial=0), 0, -1):
        nodes = np.flatnonzero(depth == level)
        np.add.at(size, parent[nodes], size[nodes])
    return np.arange(len(parent)) + size


@dataclass(frozen=True)
class Row:
    """Inner nodes ``start`` to ``stop``, after the ``ancestors`` that they need to see."""

    ancestors: IntArray
    start: int
    stop: int

    def __len__(self) -> int:
        return len(self.ancestors) + self.stop - self.start


def cut_rows(trie: Trie, size: int) -> list[Row]:
    """Rows of at most ``size`` nodes, cut in their last quarter where fewest ancestors repeat.

    A row is longer where more than half of it would be ancestors.
    """
    rows = []
    start = 0
    while start < len(trie.token):
        ancestors = _ancestors(trie, start)
        room = max(size - len(ancestors), len(ancestors) + 1)
        stop = start + room
        if stop < len(trie.token):
            earliest = start + max(1, room - size // 4)
            depths = trie.depth[earliest : stop + 1]
            stop -= int(depths[::-1].argmin())
        else:
            stop = len(trie.token)
        rows.append(Row(ancestors, start, stop))
        start = stop
    return rows


def _ancestors(trie: Trie, node: int) -> IntArray:
    """From a first token down to the parent of ``node``."""
    path = []
    above = int(trie.parent[node])
    while above >= 0:
        path.append(above)
        above = int(trie.parent[above])
    return np.array(path[::-1], np.int64)


def batch_rows(rows: list[Row], budget: int) -> Iterator[list[Row]]:
    """Rows of similar length together, at most ``budget`` padded nodes or one row a batch."""
    lengths = np.fromiter(map(len, rows), np.int64, len(rows))
    for places in batches_by_length(lengths, budget):
        yield [rows[place] for place in places]


@dataclass(frozen=True)
class Layout:
    """A batch of rows as arrays of shape (rows, columns), and what to read from them."""

    token: IntArray
    depth: IntArray
    end: IntArray
    """The first column that does not see each column: the end of its subtree in the row."""
    positions: IntArray
    """Flat indices of the nodes that are read."""
    asked: IntArray
    """For each edge, an index into ``positions``."""
    edges: IntArray
    """The edges that are read, indices into the trie's."""


def lay_out(trie: Trie, rows: list[Row]) -> Layout:
    """Place each row's nodes; a padding column sees, and is seen by, itself alone."""
    width = max(map(len, rows))
    token = np.zeros((len(rows), width), np.int64)
    depth = np.zeros_like(token)
    end = np.tile(np.arange(1, width + 1), (len(rows), 1))
    positions, asked, edges = [], [], []
    read = 0
    for line, row in enumerate(rows):
        above, size = len(row.ancestors), len(row)
        nodes = np.concatenate([row.ancestors, np.arange(row.start, row.stop)])
        token[line, :size] = trie.token[nodes]
        depth[line, :size] = trie.depth[nodes]
        end[line, :size] = np.minimum(trie.end[nodes], row.stop) - row.start + above
        positions.append(line * width + np.arange(above, size))
        first, last = np.searchsorted(trie.edge_source, [row.start, row.stop])
        edges.append(np.arange(first, last))
        asked.append(trie.edge_source[first:last] - row.start + read)
        read += size - above
    return Layout(
        token, depth, end, np.concatenate(positions), np.concatenate(asked), np.concatenate(edges)
    )


def sum_paths(
    trie: Trie, row_nodes: int, budget: int, read: Callable[[Layout], FloatArray]
) -> FloatArray:
    """Log probability in nats of each sequence of a trie, ``[sequences]``.

    ``read`` runs a layout of at most ``budget`` nodes, in rows of ``row_nodes``, and returns the
    log probability of each of its ``edges``.
    """
    edge = np.zeros(len(trie.edge_source) + 1)
    for batch in batch_rows(cut_rows(trie, min(row_nodes, budget)), budget):
        layout = lay_out(trie, batch)
        edge[layout.edges] = read(layout)
    # Paths are padded with -1, which is the zero at the end.
    sums: FloatArray = edge[trie.path].sum(axis=1)
    return sums
