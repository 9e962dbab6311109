"""How a room is decided: arithmetic on scores, numpy only.

All arrays are in nats; the last axis runs over the candidate rooms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roomtables.schemas import PROXY

Array = NDArray[np.float64]


def log_softmax(scores: Array) -> Array:
    """Log probabilities of scores, over the last axis; a row of nothing but −inf is uniform."""
    highest = np.max(scores, axis=-1, keepdims=True)
    hopeless = np.isneginf(highest)
    shifted = np.where(hopeless, 0.0, scores - np.where(hopeless, 0.0, highest))
    result: Array = shifted - np.log(np.sum(np.exp(shifted), axis=-1, keepdims=True))
    return result


def entropy(log_probabilities: Array) -> Array:
    """H = −Σ p log p over the last axis (paper equation 3); p = 0 adds nothing."""
    p = np.exp(log_probabilities)
    finite = np.where(p > 0, log_probabilities, 0.0)
    result: Array = np.maximum(-np.sum(p * finite, axis=-1), 0.0)
    return result


def room_bias(room_logits: Array) -> Array:
    """b: the mean over objects of L = log softmax of S; ``[objects, rooms]`` → ``[rooms]``."""
    result: Array = np.mean(log_softmax(room_logits), axis=0)
    return result


def adjusted(room_logits: Array, bias: Array, prior_weight: float) -> Array:
    """L′ = log softmax of (L − λ b): what each object says of each room, ``[objects, rooms]``."""
    return log_softmax(log_softmax(room_logits) - prior_weight * bias)


def effective_prior_weight(source: str, prior_weight: float) -> float:
    """λ as it acts on evidence: 0 unless the source is a language model's proxy.

    Counts have no taste in rooms to take away.
    """
    return prior_weight if source == PROXY else 0.0


def evidence_weights(adjusted_scores: Array, evidence_power: float) -> Array:
    """w(o) = (log n − H′)^γ, ``[objects]``: an object that says nothing of the room weighs nothing.

    H′ is the entropy of L′ in nats and n the number of rooms.
    """
    informativeness = np.log(adjusted_scores.shape[-1]) - entropy(adjusted_scores)
    result: Array = np.power(np.maximum(informativeness, 0.0), evidence_power)
    return result


def weighed(adjusted_scores: Array, weights: Array) -> Array:
    """w(o) L′(o, r), ``[objects, rooms]``; an object without weight adds nothing, not 0 × −inf."""
    factors = weights[..., np.newaxis]
    with np.errstate(invalid="ignore"):
        return np.where(factors > 0, factors * adjusted_scores, 0.0)


def pooled_evidence(
    room_logits: Array, bias: Array, prior_weight: float, evidence_power: float
) -> Array:
    """What each object adds to each room under rule ``pooled``, ``[objects, rooms]``."""
    scores = adjusted(room_logits, bias, prior_weight)
    return weighed(scores, evidence_weights(scores, evidence_power))
