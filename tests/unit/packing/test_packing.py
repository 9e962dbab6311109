"""The trie against what it stands for: the set of all prefixes of the sequences."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from roomtables.packing.sequences import Sequences, group_by_prefix, sort_sequences
from roomtables.packing.trie import Trie, batch_rows, build_trie, cut_rows, lay_out

token_lists = st.lists(st.lists(st.integers(0, 3), min_size=2, max_size=7), min_size=1, max_size=25)


def prefixes(tree: Trie) -> list[tuple[int, ...]]:
    """The prefix that each inner node stands for."""
    found: list[tuple[int, ...]] = []
    for token, parent in zip(tree.token.tolist(), tree.parent.tolist(), strict=True):
        found.append((*found[parent], token) if parent >= 0 else (token,))
    return found


def rows_of(sequences: Sequences) -> list[tuple[int, ...]]:
    return [tuple(sequences.row(index)) for index in range(len(sequences))]


def test_worked_example() -> None:
    sequences, index = sort_sequences([[1, 2, 4], [1, 2, 3], [1, 2, 3], [5, 6]])
    assert rows_of(sequences) == [(1, 2, 3), (1, 2, 4), (5, 6)]
    assert index.tolist() == [1, 0, 0, 2]
    tree = build_trie(sequences)
    assert prefixes(tree) == [(1,), (1, 2), (5,)]  # 3, 4 and 6 are leaves: never run
    assert tree.end.tolist() == [2, 2, 3]
    assert tree.edge_source.tolist() == [0, 1, 1, 2]
    assert tree.edge_token.tolist() == [2, 3, 4, 6]
    assert tree.path.tolist() == [[0, 1], [0, 2], [3, -1]]


@given(token_lists)
def test_sorting_keeps_every_sequence_once(lists: list[list[int]]) -> None:
    sequences, index = sort_sequences(lists)
    rows = rows_of(sequences)
    assert rows == sorted(set(map(tuple, lists)))
    assert [list(rows[i]) for i in index] == lists


@given(token_lists)
def test_inner_nodes_and_edges_are_the_prefixes(lists: list[list[int]]) -> None:
    sequences, _ = sort_sequences(lists)
    tree = build_trie(sequences)
    found = prefixes(tree)
    distinct = {tuple(tokens) for tokens in lists}
    expected = {tokens[:size] for tokens in distinct for size in range(1, len(tokens))}
    assert found == sorted(expected)
    edges = [
        (*found[source], token)
        for source, token in zip(tree.edge_source.tolist(), tree.edge_token.tolist(), strict=True)
    ]
    for row, path in zip(rows_of(sequences), tree.path.tolist(), strict=True):
        read = [edges[edge] for edge in path if edge >= 0]
        assert read == [row[:size] for size in range(2, len(row) + 1)]


@given(token_lists, st.integers(2, 30), st.integers(1, 60))
def test_each_node_sees_its_ancestors_and_is_read_once(
    lists: list[list[int]], size: int, budget: int
) -> None:
    tree = build_trie(sort_sequences(lists)[0])
    found = prefixes(tree)
    edges_read: list[int] = []
    nodes_read: list[tuple[int, ...]] = []
    for batch in batch_rows(cut_rows(tree, size), budget):
        layout = lay_out(tree, batch)
        width = layout.token.shape[1]
        assert len(batch) == 1 or len(batch) * width <= budget
        seen = []
        for flat in layout.positions.tolist():
            line, column = divmod(flat, width)
            visible = [other for other in range(column + 1) if column < layout.end[line, other]]
            assert layout.depth[line, visible].tolist() == list(range(len(visible)))
            seen.append(tuple(layout.token[line, visible].tolist()))
        nodes_read += seen
        for edge, asked in zip(layout.edges.tolist(), layout.asked.tolist(), strict=True):
            assert seen[asked] == found[tree.edge_source[edge]]
        edges_read += layout.edges.tolist()
    assert sorted(nodes_read) == found
    assert sorted(edges_read) == list(range(len(tree.edge_source)))


@given(token_lists, st.integers(1, 60))
def test_groups_share_their_prefix(lists: list[list[int]], budget: int) -> None:
    sequences, _ = sort_sequences(lists)
    rows = rows_of(sequences)
    covered = []
    for group in group_by_prefix(sequences, budget):
        members = rows[group.start : group.stop]
        assert len({row[: group.prefix] for row in members}) == 1
        assert all(len(row) > group.prefix for row in members)
        assert len(members) == 1 or len(members) * max(map(len, members)) <= budget
        covered += members
    assert covered == rows


def test_rows_cut_where_few_ancestors_repeat() -> None:
    families = [[first, *range(10, 20), last] for first in range(8) for last in range(30, 33)]
    tree = build_trie(sort_sequences(families)[0])
    rows = cut_rows(tree, 25)
    assert [len(row.ancestors) for row in rows] == [0] * len(rows)
    assert np.sum([len(row) for row in rows]) == len(tree.token)
