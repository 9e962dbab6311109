"""The same tables under the other reduction: S as sum or mean of log probabilities.

Both come from the same sentence scores, so a proxy's p(room | object) can be had for either without
a language model. Query sentences cannot: another reduction ranks objects in another order, and the
order is part of the sentence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from roomtables.online import rules
from roomtables.online.classifier import RoomTables
from roomtables.online.model import QueryModel
from roomtables.schemas import ENTROPY_DECIMALS, PROXY, REDUCTIONS
from roomtables.sentences import Template
from roomtables.storage.lookup import Lookup, SourceArrays
from roomtables.storage.views import connect, select


def with_other_reduction(tables: RoomTables) -> tuple[RoomTables | None, str]:
    """Tables of source ``proxy`` for rule ``pooled`` under the other reduction, and what of it.

    The first is ``None`` where the sentence scores are not there.
    """
    other = next(name for name in REDUCTIONS if name != tables.lookup.reduction)
    rebuild = f"run `roomtables build --reduction {other}`"
    scores = _scores(tables, other)
    if scores is None:
        return None, f"reduction {other}: the sentence scores are not in the tables; {rebuild}"
    arrays = _arrays(scores, tables.lookup)
    lookup = replace(tables.lookup, reduction=other, sources={PROXY: arrays})
    model = QueryModel(tables.version.manifest, allowed=False)
    decision = replace(tables.decision, source=PROXY)
    found = RoomTables(tables.version, lookup, model, decision)
    return found, f"reduction {other} of query sentences: {rebuild}"


def _scores(tables: RoomTables, reduction: str) -> NDArray[np.float64] | None:
    """S(o, r) ``[objects, rooms]`` in nats, or ``None`` where a sentence has no score."""
    lookup = tables.lookup
    template = Template(lookup.template)
    sentences = [text for o in lookup.objects for text in template.compose([o], lookup.rooms)]
    connection = connect(tables.version.path.parents[1], tables.version)
    try:
        scorer = str(tables.version.manifest["scorer_id"]).replace("'", "''")
        _, rows = select(
            connection,
            "select sentence, log_prob, token_count from sentence_scores "
            f"where scorer_id = '{scorer}'",
        )
    finally:
        connection.close()
    held = {sentence: (log_prob, tokens) for sentence, log_prob, tokens in rows}
    if not held.keys() >= set(sentences):
        return None
    pairs = np.array([held[sentence] for sentence in sentences])
    values = pairs[:, 0] if reduction == "sum" else pairs[:, 0] / pairs[:, 1]
    return values.reshape(len(lookup.objects), len(lookup.rooms))


def _arrays(scores: NDArray[np.float64], lookup: Lookup) -> SourceArrays:
    """What the build would write for these scores, without combinations."""
    labels = [o.label for o in lookup.objects]
    entropy = rules.entropy(rules.log_softmax(scores))
    order = sorted(
        range(len(labels)), key=lambda n: (round(float(entropy[n]), ENTROPY_DECIMALS), labels[n])
    )
    ranks = np.empty(len(labels), np.int32)
    ranks[order] = np.arange(1, len(labels) + 1)
    predicted = [number for number, room in enumerate(lookup.rooms) if room.predicted]
    return SourceArrays(
        entropy,
        ranks,
        scores,
        rules.room_bias(scores[:, predicted]),
        np.empty(0, np.uint64),
        np.empty((0, len(predicted)), np.float32),
    )
