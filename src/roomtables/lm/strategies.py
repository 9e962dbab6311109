"""Ways to score token sequences with a causal language model: equal results, unequal speed.

Every :data:`Strategy` takes sorted sequences and returns their log probabilities in nats,
``[sequences]``, float64. No forward pass holds more than ``budget`` padded tokens, unless a single
sequence or row does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor
from transformers import DynamicCache

from roomtables.lm.forward import Forward
from roomtables.lm.scorer import Meter
from roomtables.packing.sequences import (
    FloatArray,
    Group,
    Sequences,
    group_by_prefix,
    padded_batches,
)
from roomtables.packing.tokens import IntArray
from roomtables.packing.trie import Layout, build_trie, sum_paths

Strategy = Callable[[Forward, Sequences, int, Meter], FloatArray]

ROW_NODES = 128
"""Nodes in a row of a packed pass: attention costs the square of it, repeated ancestors its
inverse."""


def trie(
    forward: Forward, sequences: Sequences, budget: int, meter: Meter, row_nodes: int = ROW_NODES
) -> FloatArray:
    """Every distinct prefix once: the inner nodes of the token trie, in rows of ``row_nodes``."""
    tree = build_trie(sequences)

    def read(layout: Layout) -> FloatArray:
        token, depth, end = map(forward.tensor, (layout.token, layout.depth, layout.end))
        inputs = packed_inputs(token, depth, end, forward.dtype)
        targets = tree.edge_token[layout.edges]
        log_probs = forward.read(inputs, layout.positions, layout.asked, targets)
        meter.advance(len(layout.edges) / len(tree.edge_source), layout.token.size)
        return log_probs

    return sum_paths(tree, row_nodes, budget, read)


def packed_inputs(token: Tensor, depth: Tensor, end: Tensor, dtype: torch.dtype) -> dict[str, Any]:
    """A model's keyword arguments for rows of a token trie, each tensor ``[rows, columns]``.

    The additive mask lets a node see itself and its ancestors: in preorder those are the earlier
    columns whose subtree has not ended. It is in the model's ``dtype``, because eager attention
    adds a boolean mask as 0 and 1, silently.
    """
    columns = torch.arange(end.shape[1], device=end.device)
    sees = (columns[:, None] >= columns) & (columns[:, None] < end[:, None, :])
    mask = torch.zeros(sees.shape, dtype=dtype, device=end.device)
    return {
        "input_ids": token,
        "position_ids": depth,
        "attention_mask": mask.masked_fill(~sees, torch.finfo(dtype).min)[:, None],
        "use_cache": False,
    }


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
    shared, count, first = group.prefix, len(matrix), sequences.first[group.rows]
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
        own += _of_prefix(log_probs, shared, first)
        cache.batch_repeat_interleave(count)
    rest = matrix[:, shared:]
    present = rest >= 0
    place = shared + np.arange(1, rest.shape[1])
    line, column = np.nonzero(present[:, 1:] & (place >= first[:, None]))
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


def _of_prefix(log_probs: FloatArray, shared: int, first: IntArray) -> FloatArray:
    """What each sequence's tokens up to the first behind a shared prefix add, ``[sequences]``.

    ``log_probs`` are those of the prefix's tokens but its first, then of each sequence's next
    token; ``first`` is each sequence's first scored token.
    """
    from_token = np.append(np.cumsum(log_probs[: shared - 1][::-1])[::-1], 0.0)
    added: FloatArray = from_token[np.minimum(first, shared) - 1]
    added += np.where(first <= shared, log_probs[shared - 1 :], 0.0)
    return added


def padded(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """Right-padded batches of sequences of similar length, which every causal model can run."""
    scores = np.empty(len(sequences))
    for batch in padded_batches(sequences, budget):
        inputs = {
            "input_ids": forward.tensor(batch.token),
            "attention_mask": forward.tensor(batch.present.astype(np.int64)),
        }
        asked = np.arange(len(batch.positions))
        log_probs = forward.read(inputs, batch.positions, asked, batch.target)
        scores[batch.rows] = np.bincount(batch.line, log_probs, minlength=len(batch.rows))
        meter.advance(len(batch.rows) / len(sequences), batch.token.size)
    return scores


def naive(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """One plain forward per sequence: the last resort, where all other strategies disagree."""
    scores = np.empty(len(sequences))
    for row in range(len(sequences)):
        tokens = sequences.row(row)
        scores[row] = forward.sequence(tokens)[sequences.first[row] - 1 :].sum()
        meter.advance(1 / len(sequences), len(tokens))
    return scores
