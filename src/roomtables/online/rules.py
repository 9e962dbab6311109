"""The formulas by which a room is decided: arithmetic on scores, with numpy alone.

Scores and log probabilities are in nats; the last axis of an array runs over rooms. S(o, r) is the
score of the sentence about object o and room r.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from roomtables.schemas import ENTROPY_DECIMALS, PROXY

Array = NDArray[np.float64]


def log_softmax(scores: Array) -> Array:
    """L = log softmax of S over the rooms (paper equation 2, as logarithms), shaped as the scores.

    Where all rooms are impossible (−inf), all are alike.
    """
    highest = np.max(scores, axis=-1, keepdims=True)
    hopeless = np.isneginf(highest)
    shifted = np.where(hopeless, 0.0, scores - np.where(hopeless, 0.0, highest))
    result: Array = shifted - np.log(np.sum(np.exp(shifted), axis=-1, keepdims=True))
    return result


def over_templates(scores: Array, rooms: int) -> Array:
    """S(o, r) of single objects, from the score that each template's sentence has.

    Of one template it is that score; of several, the mean of each one's log softmax over the first
    ``rooms`` of the last axis, which are those of the label space, so that no template counts for
    more because its scores differ more: ``[…, templates, rooms and others]`` → ``[…, rooms and
    others]``, in nats.
    """
    if scores.shape[-2] == 1:
        return scores[..., 0, :]
    of_space = scores[..., :rooms]
    log_total = of_space[..., :1] - log_softmax(of_space)[..., :1]
    result: Array = np.mean(scores - log_total, axis=-2)
    return result


def entropy(log_probabilities: Array) -> Array:
    """H = −Σ p log p over the rooms (paper equation 3), in nats; p = 0 adds nothing.

    ``[…, rooms]`` → ``[…]``.
    """
    p = np.exp(log_probabilities)
    finite = np.where(p > 0, log_probabilities, 0.0)
    result: Array = np.maximum(-np.sum(p * finite, axis=-1), 0.0)
    return result


def rank_key(entropy_nats: float, label: str) -> tuple[float, str]:
    """What objects are ranked by: least entropy H first; where that is equal, by label."""
    return round(entropy_nats, ENTROPY_DECIMALS), label


def room_bias(room_logits: Array) -> Array:
    """b(r) = mean over objects of L(o, r): how much a model likes a room, whatever the object.

    ``[objects, rooms]`` of S → ``[rooms]``, in nats.
    """
    result: Array = np.mean(log_softmax(room_logits), axis=0)
    return result


def effective_prior_weight(source: str, prior_weight: float) -> float:
    """λ as it acts on the evidence of single objects: 0 for counts, which have no bias."""
    return prior_weight if source == PROXY else 0.0


def adjusted(room_logits: Array, bias: Array, prior_weight: float) -> Array:
    """L′ = log softmax of (L − λ b): what an object says of each room, less the model's bias.

    ``[…, rooms]`` of S → ``[…, rooms]``, in nats.
    """
    return log_softmax(log_softmax(room_logits) - prior_weight * bias)


def evidence_weights(adjusted_scores: Array, evidence_power: float) -> Array:
    """w(o) = (log n − H′)^γ, with H′ the entropy of L′ over n rooms: ``[…, rooms]`` → ``[…]``.

    An object that says nothing of the room weighs nothing (but 1 where γ is 0).
    """
    informativeness = np.log(adjusted_scores.shape[-1]) - entropy(adjusted_scores)
    result: Array = np.power(np.maximum(informativeness, 0.0), evidence_power)
    return result


def count_factor(n: float) -> float:
    """1 + ln n: what n objects of a kind multiply w(o) by; below one object, n itself.

    Sublinear term weighting: ten chairs say more than one, but not ten times as much.
    """
    return 1 + math.log(n) if n >= 1 else n


def evidence(adjusted_scores: Array, weights: Array) -> Array:
    """w(o) L′(o, r): what each object adds to each room under rule ``pooled``, in nats.

    ``[…, rooms]`` and ``[…]`` → ``[…, rooms]``. An object without weight adds 0, not 0 × −inf.
    """
    factors = weights[..., np.newaxis]
    with np.errstate(invalid="ignore"):
        return np.where(factors > 0, factors * adjusted_scores, 0.0)
