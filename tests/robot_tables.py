"""Published tables made with numpy alone, for a Python that has neither duckdb nor pyarrow."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roomtables.config import BuildConfig
from roomtables.labels import LabelSpace
from roomtables.online import rules
from roomtables.schemas import GROUND_TRUTH, PROXY
from roomtables.scorer import Scorer
from roomtables.sentences import Template
from roomtables.storage.lookup import pack_keys
from roomtables.storage.lookup_writer import LookupSettings, ScoreChunks, write_lookup
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version
from support import made_manifest


def small_arrays(room_logits: NDArray[Any], space: LabelSpace) -> dict[str, NDArray[Any]]:
    """What a lookup holds beside keys and scores, from S(o, r)."""
    entropy = rules.entropy(rules.log_softmax(room_logits))
    ordered = sorted(
        range(len(entropy)),
        key=lambda n: rules.rank_key(float(entropy[n]), space.objects[n].label),
    )
    ranks = np.empty(len(entropy), np.int32)
    ranks[ordered] = np.arange(1, len(entropy) + 1)
    predicted = [n for n, room in enumerate(space.rooms) if room.predicted]
    bias = rules.room_bias(room_logits[:, predicted])
    return {"entropy": entropy, "ranks": ranks, "room_logits": room_logits, "bias": bias}


def publish(
    tables: Path,
    space: LabelSpace,
    scorer: Scorer,
    *,
    counts: Mapping[tuple[str, str], float] | None = None,
    held: Collection[frozenset[str]] | None = None,
    **settings: Any,
) -> Version:
    """Publish tables of a scorer's answers, and of counts where there are some.

    ``held`` are the combinations whose query scores the tables hold (``None``: all of them);
    ``settings`` are those of a build.
    """
    config = BuildConfig(labels=space.name, **settings)
    logits = {PROXY: _scored(space, scorer, [[label] for label in space.objects])}
    if counts is not None:
        smoothing = 1 / len(space.rooms) if config.smoothing is None else config.smoothing
        rows = [[counts.get((o.label, r.label), 0.0) for r in space.rooms] for o in space.objects]
        added = np.array(rows) + smoothing
        added[added.sum(axis=1) == 0] = 1.0  # never seen: it says nothing
        with np.errstate(divide="ignore"):
            logits[GROUND_TRUTH] = np.log(added / added.sum(axis=1, keepdims=True))
    bias = small_arrays(logits[PROXY], space)["bias"]  # the model's, whatever the source
    sources = {}
    for source, room_logits in logits.items():
        arrays = small_arrays(room_logits, space) | {"bias": bias}
        sources[source] = arrays, _query_scores(space, scorer, arrays["ranks"], held, config.k)
    folder = SpaceFolder(tables, space.name)
    with folder.staging() as staging:
        used = LookupSettings(*(getattr(config, name) for name in LookupSettings._fields))
        write_lookup(staging / LOOKUP, space, used, sources)
        manifest = made_manifest(
            staging,
            labels=space.name,
            settings=config,
            scorer_id=scorer.scorer_id,
            query_scorer_id=scorer.scorer_id,
            objects=len(space.objects),
            rooms=len(space.rooms),
            predicted_rooms=len(space.predicted_rooms),
            combinations={source: scores.rows for source, (_, scores) in sources.items()},
        )
        return folder.publish(staging, folder.new_name("madeupxx"), manifest)


def _scored(space: LabelSpace, scorer: Scorer, groups: Sequence[Any]) -> NDArray[Any]:
    """S of the sentences of groups of objects and every room, ``[groups, rooms]``."""
    template = Template()
    sentences = [text for group in groups for text in template.compose(group, space.rooms)]
    scores = [score.log_prob for score in scorer.score(sentences)] if sentences else []
    return np.array(scores).reshape(len(groups), len(space.rooms))


def _query_scores(
    space: LabelSpace,
    scorer: Scorer,
    ranks: NDArray[Any],
    held: Collection[frozenset[str]] | None,
    k: int,
) -> ScoreChunks:
    by_rank = [space.objects[number] for number in np.argsort(ranks)]
    picked = [
        chosen
        for size in range(1, k + 1)
        for chosen in combinations(range(len(by_rank)), size)
        if held is None or frozenset(by_rank[at].label for at in chosen) in held
    ]
    padded = np.zeros((len(picked), k), np.int64)
    for row, chosen in enumerate(picked):
        padded[row, : len(chosen)] = np.add(chosen, 1)
    keys = pack_keys(padded, k)
    order = np.argsort(keys)
    predicted = [n for n, room in enumerate(space.rooms) if room.predicted]
    groups = [[by_rank[at] for at in picked[row]] for row in order]
    scores = _scored(space, scorer, groups)[:, predicted]
    chunks = [(keys[order], scores.astype(np.float32))] if groups else []
    return ScoreChunks(len(groups), len(predicted), chunks)


def publish_index(index: Path, value: Mapping[str, Any]) -> None:
    """Let a place's pointer name an index of this content instead of one that is there."""
    content = json.dumps(value).encode()
    digest = hashlib.sha256(content).hexdigest()
    name = f"{index.stem[:-8]}{digest[:8]}"
    index.with_name(f"{name}.json").write_bytes(content)
    (index.parents[1] / "CURRENT").write_text(f"{name} {digest}\n")
