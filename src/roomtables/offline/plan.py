"""What a build would do and why: which stages are stale, and how many sentences that would score.

Nothing is scored and nothing is written under the tables folder.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.config import BuildConfig
from roomtables.offline.counting import MOST_COUNTED, Counted, by_cache, by_formula
from roomtables.offline.inputs import Inputs
from roomtables.offline.model import LazyScorer
from roomtables.offline.stages import (
    CACHED,
    SCORE_PART_MISSING,
    Stage,
    StageState,
    decide,
    is_kept,
    listed_stages,
    made_from,
    why_not_built,
)
from roomtables.scorer import Scorer
from roomtables.storage.manifest import Coverage, Rate, count_combinations
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import SpaceFolder, Version

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plan:
    """What a build would do.

    Attributes
    ----------
    published : the version that is published now
    sentences_to_score : at most so many where ``exact`` is false
    tokens : scored tokens, estimated from the sentences that the model has scored
    seconds : of scoring, at the rate that the last build of this model measured
    coverage : the combinations that the tables hold after the build
    held : the combinations that the published tables hold now
    """

    labels: str
    published: str | None
    scorer_id: str | None
    stages: tuple[StageState, ...]
    sentences_to_score: int
    exact: bool
    tokens: int | None
    sentences_per_second: float | None
    seconds: float | None
    coverage: Coverage
    held: int

    def as_json(self) -> dict[str, Any]:
        """The plan under the contract's keys."""
        return asdict(self)


def plan(
    config: BuildConfig | None = None,
    *,
    tables: str | Path = "tables",
    scorer: Scorer | None = None,
    exact: bool = False,
    **options: Any,
) -> Plan:
    """What :func:`roomtables.build` would do with the same arguments; nothing is written.

    Sentences are counted by formula, at once and as an upper bound; with ``exact`` by what the
    cache lacks, which makes the tables up to the query sentences.

    Raises
    ------
    RoomtablesError
        As the build would raise before it scores anything.
    """
    config = config.changed(**options) if config else BuildConfig.load(**options)
    root, stages = Path(tables), listed_stages(config)
    inputs = Inputs.read(config, root).and_misses(root)
    scorer_id = LazyScorer(config, scorer).scorer_id if inputs.needs_model else None
    cache = SentenceCache(root, scorer_id) if scorer_id else None
    if cache:
        cache.verify()
    space = SpaceFolder(root, inputs.labels.name)
    published = space.published()
    made = made_from(stages, inputs, scorer_id)
    absent = why_not_built(space) if published is None else ""
    states = decide(made, published, cache, config.full_refresh, absent)
    if published and all(stage.state == CACHED for stage in states):
        counted = Counted({}, True, sum(published.manifest.combinations.values()))
    else:
        kept = published and not config.full_refresh and is_kept(published, cache)
        counted = by_formula(inputs, states, made, published if kept else None)
        if exact and not counted.exact:
            counted = _looked_up(inputs, cache, stages, counted)
        states = [_as_counted(stage, counted) for stage in states]
    return _plan(inputs, cache, published, states, counted)


def _looked_up(
    inputs: Inputs, cache: SentenceCache | None, stages: tuple[Stage, ...], bound: Counted
) -> Counted:
    """What the cache lacks; of combinations too many to be written out, the upper bound."""
    if bound.combinations <= MOST_COUNTED:
        return by_cache(inputs, cache, stages)
    log.warning(
        "%s combinations are too many to be looked up one by one; counted by formula",
        f"{bound.combinations:,}",
    )
    return bound


def _as_counted(stage: StageState, counted: Counted) -> StageState:
    """A stage with its sentences; the score part that is missing held none of some stage's."""
    sentences = counted.sentences.get(stage.stage, 0)
    if stage.why == SCORE_PART_MISSING and counted.total and not sentences:
        return replace(stage, state=CACHED, why="")
    return replace(stage, sentences=sentences)


def _plan(
    inputs: Inputs,
    cache: SentenceCache | None,
    published: Version | None,
    states: Sequence[StageState],
    counted: Counted,
) -> Plan:
    rate = _rate(cache) if cache else None
    labels = inputs.labels
    sources = 1 if inputs.counts is None else 2
    possible = sources * count_combinations(len(labels.objects), inputs.config.k)
    return Plan(
        labels.name,
        published.name if published else None,
        cache.scorer_id if cache else None,
        tuple(states),
        counted.total,
        counted.exact,
        round(counted.total * rate.tokens_per_sentence) if rate else None,
        rate.sentences_per_second if rate else None,
        round(counted.total / rate.sentences_per_second, 1) if rate else None,
        Coverage.of(possible, counted.combinations, len(labels.predicted_rooms), rate),
        sum(published.manifest.combinations.values()) if published else 0,
    )


def _rate(cache: SentenceCache) -> Rate | None:
    """What the newest build of this model measured, whatever its label space."""
    tables = cache.folder.parents[1]
    published = (SpaceFolder(tables, path.name).published() for path in tables.glob("[!.]*"))
    of_model = [
        version.manifest
        for version in published
        if version and version.manifest.query_scorer_id == cache.scorer_id and version.manifest.rate
    ]
    newest = max(of_model, key=lambda manifest: manifest.created, default=None)
    return newest.rate if newest else None
