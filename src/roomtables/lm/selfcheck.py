"""A fast strategy is used only after it has agreed with naive scoring on the model at hand.

Several architectures ignore a packed mask or a cache silently, so the check scores enough token
sequences to fill more than a row, cuts included, and compares a sample with one plain forward each.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Sequence

import numpy as np
import torch

from roomtables.errors import ModelError, first_line
from roomtables.lm.encoding import Encoder
from roomtables.lm.forward import Forward
from roomtables.lm.scorer import Meter
from roomtables.lm.strategies import ROW_NODES, Strategy
from roomtables.packing.sequences import FloatArray, Sequences, sort_sequences
from roomtables.packing.tokens import IntArray
from roomtables.scorer import TOLERANCE_NATS

_log = logging.getLogger(__name__)

_SAMPLE = 8
_LARGEST_IN_FLOAT32 = 1_500_000_000  # weights; beyond, the check runs in the model's own dtype


def choose(
    candidates: Sequence[tuple[str, Strategy]], forward: Forward, encoder: Encoder, budget: int
) -> tuple[str, Strategy, list[str]]:
    """The first candidate that agrees with naive scoring, and why those before it do not.

    Raises
    ------
    ModelError
        The model cannot be scored naively, its scores are not finite, or no candidate agrees.
    """
    sequences = sample_sequences(encoder)
    picked = np.unique(np.linspace(0, len(sequences) - 1, _SAMPLE).astype(int))
    fallbacks: list[str] = []
    with in_float32(forward):
        expected = _naive(forward, sequences, picked, encoder.name)
        for name, strategy in candidates:
            why = _disagreement(strategy, forward, sequences, budget, picked, expected)
            if why is None:
                return name, strategy, fallbacks
            fallbacks.append(f"{name}: {why}")
            _log.warning("%s: strategy %s is not used: %s", encoder.name, name, why)
    raise ModelError(f"{encoder.name} gives other scores each time; use another --model")


def sample_sequences(encoder: Encoder) -> Sequences:
    """Families of token sequences, prefixes with many endings, that fill more than a row.

    All begin alike, so that a row's last nodes reach back to its first, beyond any local window
    that counts columns. Tokens are drawn at random, always the same, which suits any tokenizer.
    """
    generator = np.random.default_rng(0)
    lead, ordinary = encoder.sample_tokens()
    longest = min(24, encoder.context or 24)

    def drawn(size: int) -> list[int]:
        tokens: list[int] = generator.choice(ordinary, size).tolist()
        return tokens

    root = lead + drawn(2)
    sequences, nodes = [], 0
    while nodes < 1.3 * ROW_NODES:
        prefix = root + drawn(int(generator.integers(1, max(2, longest - 8))))
        for _ in range(8):
            ending = drawn(int(generator.integers(1, 7)))
            sequences.append((prefix + ending)[:longest])
            nodes += len(ending) - 1
        nodes += len(prefix) - len(root)
    return sort_sequences([tokens for tokens in sequences if len(tokens) > 1])[0]


def _naive(forward: Forward, sequences: Sequences, picked: IntArray, name: str) -> FloatArray:
    try:
        scores = np.array([forward.sequence(sequences.row(row)).sum() for row in picked])
    except Exception as error:
        why = f"{type(error).__name__}: {first_line(error)}"
        raise ModelError(
            f"{name} cannot score a plain sentence ({why}); use another --model"
        ) from error
    if not np.isfinite(scores).all():
        raise ModelError(
            f"{name} returns log probabilities that are not finite; its weights are damaged, "
            "or need --dtype float32"
        )
    return scores


def _disagreement(
    strategy: Strategy,
    forward: Forward,
    sequences: Sequences,
    budget: int,
    picked: IntArray,
    expected: FloatArray,
) -> str | None:
    try:
        meter = Meter()
        meter.begin(len(sequences), int(sequences.lengths.sum()))
        scores = strategy(forward, sequences, budget, meter)[picked]
    except torch.cuda.OutOfMemoryError:
        raise
    except Exception as error:  # whatever an architecture does with inputs it does not expect
        return f"{type(error).__name__}: {first_line(error)}"
    if agree(forward, scores, expected):
        return None
    return f"{np.abs(scores - expected).max():.2g} nats from naive scoring"


def agree(forward: Forward, scores: FloatArray, expected: FloatArray) -> bool:
    """Whether scores (nats, ``[sequences]``) are equal up to 1e-3 and the rounding of the dtype.

    NaN equals nothing.
    """
    slack = 2 * torch.finfo(forward.dtype).eps * np.abs(expected)
    return bool((np.abs(scores - expected) <= TOLERANCE_NATS + slack).all())


@contextlib.contextmanager
def in_float32(forward: Forward) -> Iterator[None]:
    """Cast a half-precision model to float32 for a while; its weights come back unchanged.

    In float32 a wrong strategy is not mistaken for the rounding of half precision. A model too
    large for that, on the GPU or by count, stays as it is.
    """
    model = forward.model
    tensors = [*model.parameters(), *model.buffers()]
    half = {torch.float16, torch.bfloat16}
    cast = [(tensor, tensor.dtype) for tensor in tensors if tensor.dtype in half]
    if sum(tensor.numel() for tensor, _ in cast) > _LARGEST_IN_FLOAT32:
        cast = []

    def back() -> None:
        for tensor, dtype in cast:
            tensor.data = tensor.data.to(dtype)

    try:
        try:
            for tensor, _ in cast:
                tensor.data = tensor.data.to(torch.float32)
        except torch.cuda.OutOfMemoryError:
            back()
        yield
    finally:
        back()
