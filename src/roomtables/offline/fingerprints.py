"""What each stage's table depends on, as three hashes: the model, the code, the input.

A stage is up to date when all three are what the published version notes; otherwise the first that
differs says why it is stale. Each hash covers the stages before it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from roomtables.offline.inputs import Inputs
from roomtables.offline.stages import stage_sql
from roomtables.schemas import SCHEMA_VERSION


class Fingerprint(NamedTuple):
    """Hashes of what decides a stage's table."""

    model: str
    code: str
    input: str


@dataclass(frozen=True)
class _Own:
    """What a stage depends on besides the stages ``after`` which it comes."""

    after: tuple[str, ...] = ()
    model: object = None
    sql: tuple[str, ...] = ()
    input: object = None


def stage_fingerprints(inputs: Inputs, scorer_id: str | None) -> dict[str, Fingerprint]:
    """Every stage's fingerprint, in the order of the stages."""
    found: dict[str, Fingerprint] = {}
    for stage, own in _stages(inputs, scorer_id).items():
        before = [found[name] for name in own.after]
        found[stage] = Fingerprint(
            _hash([own.model, *(b.model for b in before)]),
            _hash([SCHEMA_VERSION, *map(stage_sql, own.sql), *(b.code for b in before)]),
            _hash([own.input, *(b.input for b in before)]),
        )
    return found


def combined(fingerprints: Mapping[str, Fingerprint]) -> str:
    """One hash over all stages: what names a version."""
    return _hash(fingerprints)


def _stages(inputs: Inputs, scorer_id: str | None) -> dict[str, _Own]:
    config, labels = inputs.config, inputs.labels
    imported = inputs.scores.fingerprint if inputs.scores else None
    settings: dict[str, Any] = {"template": config.template, "reduction": config.reduction}
    every = config.combinations in {"all", "none"}
    asked = config.combinations if every else [inputs.rooms, inputs.asked.fingerprint()]
    evidence = {
        "counts": inputs.counts.fingerprint if inputs.counts else None,
        "scores": imported,
        "smoothing": inputs.smoothing,
    }
    decision = {n: getattr(config, n) for n in ("source", "rule", "prior_weight", "evidence_power")}
    return {
        "objects": _Own(input=[(o.label, o.plural) for o in labels.objects]),
        "rooms": _Own(input=[(r.label, r.article, r.predicted) for r in labels.rooms]),
        "sentence_scores": _Own(
            ("objects", "rooms"), scorer_id, (), [config.template, config.k, asked]
        ),
        "cooccurrence": _Own(
            ("objects", "rooms"),
            None if imported else scorer_id,
            ("single_scores", "cooccurrence"),
            settings | evidence,
        ),
        "entropy": _Own(("cooccurrence",), sql=("entropy",)),
        "room_bias": _Own(("cooccurrence",), sql=("room_bias",)),
        "query_scores": _Own(("sentence_scores", "entropy"), sql=("query_scores",)),
        "lookup": _Own(
            ("query_scores", "room_bias"), input=[labels.name, labels.fingerprint, decision]
        ),
    }


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, default=str).encode()).hexdigest()[:16]
