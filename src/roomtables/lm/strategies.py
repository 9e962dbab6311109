"""Ways to score token sequences with a causal language model: equal results, unequal speed.

Every :data:`Strategy` takes sorted sequences and returns their log probabilities in nats,
``[sequences]``, float64. No forward pass holds more than ``budget`` padded tokens, unless a single
sequence or row does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor
from transformers import DynamicCache

from roomtables.lm.forward import FloatArray, Forward
from roomtables.lm.scorer import Meter
from roomtables.lm.trie import (
    Group,
    IntArray,
    Sequences,
    batch_rows,
    build_trie,
    cut_rows,
    group_by_prefix,
    lay_out,
)

Strategy = Callable[[Forward, Sequences, int, Meter], FloatArray]

ROW_NODES = 128
"""Nodes in a row of a packed pass: attention costs the square of it, repeated ancestors its
inverse."""


def trie(
    forward: Forward, sequences: Sequences, budget: int, meter: Meter, row_nodes: int = ROW_NODES
) -> FloatArray:
    """Every distinct prefix once: the inner nodes of the token trie, in rows of ``row_nodes``."""
    tree = build_trie(sequences)
    rows = cut_rows(tree, min(row_nodes, budget))
    edge = np.zeros(len(tree.edge_source) + 1)
    for batch in batch_rows(rows, budget):
        layout = lay_out(tree, batch)
        inputs = {
            "input_ids": forward.tensor(layout.token),
            "position_ids": forward.tensor(layout.depth),
            "attention_mask": _ancestor_mask(forward, layout.end),
            "use_cache": False,
        }
        tokens = tree.edge_token[layout.edges]
        edge[layout.edges] = forward.read(inputs, layout.positions, layout.asked, tokens)
        meter.advance(len(layout.edges) / len(tree.edge_source), layout.token.size)
    # Paths are padded with -1, which is the zero at the end.
    scores: FloatArray = edge[tree.path].sum(axis=1)
    return scores


def _ancestor_mask(forward: Forward, end: IntArray) -> Tensor:
    """Additive mask ``[rows, 1, columns, columns]``: a node sees itself and its ancestors.

    In preorder those are the earlier columns whose subtree has not ended. Additive in the model's
    dtype, because a boolean mask is added as 0 and 1 by eager attention, silently.
    """
    columns = torch.arange(end.shape[1], device=forward.device)
    ends = forward.tensor(end)
    sees = (columns[:, None] >= columns) & (columns[:, None] < ends[:, None, :])
    mask = torch.zeros(sees.shape, dtype=forward.dtype, device=forward.device)
    return mask.masked_fill_(~sees, torch.finfo(forward.dtype).min)[:, None]


def key_value(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """A common prefix once, its keys and values repeated for a batch of its continuations."""
    scores = np.empty(len(sequences))
    for group in group_by_prefix(sequences, budget):
        scores[group.start : group.stop] = _score_group(forward, sequences, group)
        tokens = group.prefix + int((sequences.lengths[group.rows] - group.prefix).sum())
        meter.advance((group.stop - group.start) / len(sequences), tokens)
    return scores


@torch.inference_mode()
def _score_group(forward: Forward, sequences: Sequences, group: Group) -> FloatArray:
    matrix = sequences.matrix[group.rows, : sequences.lengths[group.rows].max()]
    shared, count = group.prefix, len(matrix)
    own = np.zeros(count)
    cache = None
    if shared:
        # Fresh for every group: a forward changes its cache in place.
        cache = DynamicCache(config=forward.model.config)
        prefix = matrix[:1, :shared]
        inputs = {
            "input_ids": forward.tensor(prefix),
            "attention_mask": forward.tensor(np.ones_like(prefix)),
            "past_key_values": cache,
            "use_cache": True,
        }
        # From the prefix: its own tokens but the first, and the first token of each continuation.
        within = np.arange(shared - 1)
        asked = np.concatenate([within, np.full(count, shared - 1)])
        tokens = np.concatenate([prefix[0, 1:], matrix[:, shared]])
        log_probs = forward.read(inputs, np.arange(shared), asked, tokens)
        own += log_probs[: shared - 1].sum() + log_probs[shared - 1 :]
        cache.batch_repeat_interleave(count)
    rest = matrix[:, shared:]
    present = rest >= 0
    line, column = np.nonzero(present[:, 1:])
    if not len(line):
        return own
    width = int(column.max()) + 1  # the last token of the longest is read, never run
    ids = np.where(present, rest, 0)[:, :width]
    inputs = {
        "input_ids": forward.tensor(ids),
        "attention_mask": forward.tensor((matrix[:, : shared + width] >= 0).astype(np.int64)),
        "use_cache": shared > 0,
    }
    if shared:
        inputs["past_key_values"] = cache
    positions = line * width + column
    log_probs = forward.read(inputs, positions, np.arange(len(line)), rest[line, column + 1])
    return own + np.bincount(line, weights=log_probs, minlength=count)


def padded(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """Right-padded batches of sequences of similar length, which every causal model can run."""
    scores = np.empty(len(sequences))
    for rows in batches_by_length(sequences.lengths, budget):
        width = int(sequences.lengths[rows].max()) - 1  # the last token is read, never run
        matrix = sequences.matrix[rows, : width + 1]
        present = matrix >= 0
        inputs = {
            "input_ids": forward.tensor(np.where(present, matrix, 0)[:, :width]),
            "attention_mask": forward.tensor(present[:, :width].astype(np.int64)),
        }
        line, column = np.nonzero(present[:, 1:])
        positions = line * width + column
        log_probs = forward.read(inputs, positions, np.arange(len(line)), matrix[line, column + 1])
        scores[rows] = np.bincount(line, weights=log_probs, minlength=len(rows))
        meter.advance(len(rows) / len(sequences), len(rows) * width)
    return scores


def naive(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """One plain forward per sequence: the last resort, where all other strategies disagree."""
    scores = np.empty(len(sequences))
    for row in range(len(sequences)):
        tokens = sequences.row(row)
        scores[row] = forward.sequence(tokens).sum()
        meter.advance(1 / len(sequences), len(tokens))
    return scores


def batches_by_length(lengths: IntArray, budget: int) -> Iterator[IntArray]:
    """Indices of sequences, longest first, in batches of at most ``budget`` padded tokens."""
    order = np.argsort(-lengths, kind="stable")
    start = 0
    while start < len(order):
        rows = max(1, budget // int(lengths[order[start]]))
        yield order[start : start + rows]
        start += rows
