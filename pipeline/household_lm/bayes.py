"""The knowledge as a naive Bayes model: log p(object is there | room), and the exact posterior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .facts import Facts

# How probable an object is in a room whose file does not name it: a share of its mean over all
# rooms, for what is rare everywhere is rarer still where nobody thinks of it.
UNNAMED_SHARE = 0.5
UNNAMED_AT_MOST = 0.02
NEVER_SHARE = 0.25  # the same, of that, where the file says that it is never there


def log_presence(facts: Facts) -> NDArray[np.float64]:
    """Log p(object is there | room) in nats; one row per object, one column per room."""
    places = {name: row for row, name in enumerate(facts.things)}
    named = np.zeros((len(facts.things), len(facts.rooms)))
    never = np.zeros(named.shape, dtype=bool)
    for column, room in enumerate(facts.rooms.values()):
        for name, probability in room.objects.items():
            named[places[name], column] = probability
        never[[places[name] for name in room.never], column] = True
    unnamed = np.clip(named.mean(1, keepdims=True) * UNNAMED_SHARE, 1e-4, UNNAMED_AT_MOST)
    present = np.where(named > 0, named, np.where(never, unnamed * NEVER_SHARE, unnamed))
    found: NDArray[np.float64] = np.log(present)
    return found


def log_posterior(facts: Facts, sets: Sequence[Sequence[str]]) -> NDArray[np.float64]:
    """Log p(room | objects) in nats, all rooms as likely before: one row per set of objects."""
    places = {name: row for row, name in enumerate(facts.things)}
    presence = log_presence(facts)
    joint = np.stack([presence[[places[name] for name in names]].sum(0) for names in sets])
    joint -= joint.max(1, keepdims=True)
    found: NDArray[np.float64] = joint - np.log(np.exp(joint).sum(1, keepdims=True))
    return found
