"""Ways to score token sequences with a causal language model: equal results, unequal speed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomtables.lm.forward import FloatArray, Forward, IntArray
from roomtables.lm.progress import Meter
from roomtables.lm.sequences import Sequences


def naive(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """One forward per sequence: the reference, and what is left when all else disagrees."""
    scores = np.empty(len(sequences))
    for row in range(len(sequences)):
        tokens = sequences.row(row)
        scores[row] = forward.sequence(tokens).sum()
        meter.advance(1 / len(sequences), len(tokens))
    return scores


def padded(forward: Forward, sequences: Sequences, budget: int, meter: Meter) -> FloatArray:
    """Right-padded batches of sequences of similar length; right for every causal model."""
    scores = np.empty(len(sequences))
    for rows in batches_by_length(sequences.lengths, budget):
        width = int(sequences.lengths[rows].max())
        matrix = sequences.matrix[rows, :width]
        present = matrix >= 0
        inputs = {
            "input_ids": forward.tensor(np.where(present, matrix, 0).astype(np.int64)),
            "attention_mask": forward.tensor(present.astype(np.int64)),
        }
        line, column = np.nonzero(present[:, 1:])
        log_probs = forward.read(
            inputs,
            positions=line * width + column,
            asked=np.arange(len(line)),
            tokens=matrix[line, column + 1].astype(np.int64),
        )
        scores[rows] = np.bincount(line, weights=log_probs, minlength=len(rows))
        meter.advance(len(rows) / len(sequences), matrix.size)
    return scores


def batches_by_length(lengths: IntArray, budget: int) -> Iterator[IntArray]:
    """Indices of sequences, longest first, in batches of at most ``budget`` padded tokens."""
    order = np.argsort(-lengths, kind="stable")
    start = 0
    while start < len(order):
        rows = max(1, budget // int(lengths[order[start]]))
        yield order[start : start + rows]
        start += rows
