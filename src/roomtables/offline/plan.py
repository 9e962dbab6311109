"""What a build would do and why: which stages are stale, and how many sentences that would score.

Nothing is scored and nothing is written under the tables folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.config import ALL, BuildConfig
from roomtables.offline.inputs import Inputs, LazyScorer
from roomtables.offline.scoring import missing_sentences
from roomtables.offline.stages import (
    ASKING,
    CACHED,
    MISSING,
    QUERIES,
    QUERY_SCORES,
    SENTENCE_SCORES,
    Stage,
    StageState,
    decide,
    listed_stages,
    recorded_reads,
)
from roomtables.offline.tables import Tables, new_sentences, query_sentences
from roomtables.offline.workspace import Workspace, WorkTable, workspace
from roomtables.schemas import PROXY, literal
from roomtables.scorer import Scorer
from roomtables.storage.manifest import Coverage, Rate, count_combinations
from roomtables.storage.score_cache import NO_SCORES, SentenceCache
from roomtables.storage.scratch import scratch
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version


@dataclass(frozen=True)
class Plan:
    """What a build would do.

    Attributes
    ----------
    published : the version that is published now
    sentences_to_score : at most so many where ``exact`` is false: which sentences are asked depends
        on scores that are still to come
    tokens : scored tokens, estimated from the sentences that the model has scored
    seconds : of scoring, at the rate that the last build of this model measured
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

    def as_json(self) -> dict[str, Any]:
        """The plan under the contract's keys."""
        return asdict(self)


@dataclass(frozen=True)
class _Counted:
    """Sentences to score, by stage; whether that is exact; and the combinations that are asked."""

    sentences: Mapping[str, int]
    exact: bool
    combinations: int


def plan(
    config: BuildConfig | None = None,
    *,
    tables: str | Path = "tables",
    scorer: Scorer | None = None,
    **options: Any,
) -> Plan:
    """What :func:`roomtables.build` would do with the same arguments; nothing is written.

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
    published = SpaceFolder(root, inputs.labels.name).published()
    recorded = recorded_reads(stages, inputs, scorer_id)
    decided = decide(recorded, published, cache, config.full_refresh)
    if published and all(stage.state == CACHED for stage in decided):
        held = sum(published.manifest.combinations.values())
        counted = _Counted({}, True, held)
    else:
        with (
            scratch("plan") as folder,
            workspace(folder) as work,
        ):
            counted = _Counting(work, inputs, cache).run(stages)
    return _plan(inputs, cache, published, [_with(stage, counted) for stage in decided], counted)


def _with(stage: StageState, counted: _Counted) -> StageState:
    """A stage that asks the model, by what the cache lacks, whatever it was published with."""
    if stage.stage not in ASKING:
        return stage
    sentences = counted.sentences.get(stage.stage, 0)
    if sentences and stage.state == CACHED:
        return replace(stage, state=MISSING, why="removed", sentences=sentences)
    nothing_new = not sentences and stage.why != "refresh"
    if nothing_new and (stage.stage == SENTENCE_SCORES or stage.why == "removed"):
        return replace(stage, state=CACHED, why="")
    return replace(stage, sentences=sentences)


def _plan(
    inputs: Inputs,
    cache: SentenceCache | None,
    published: Version | None,
    found: list[StageState],
    counted: _Counted,
) -> Plan:
    rate = _rate(cache) if cache else None
    to_score = sum(counted.sentences.values())
    labels = inputs.labels
    sources = 1 if inputs.counts is None else 2
    possible = sources * count_combinations(len(labels.objects), inputs.config.k)
    return Plan(
        labels.name,
        published.name if published else None,
        cache.scorer_id if cache else None,
        tuple(found),
        to_score,
        counted.exact,
        round(to_score * rate.tokens_per_sentence) if rate else None,
        rate.sentences_per_second if rate else None,
        round(to_score / rate.sentences_per_second, 1) if rate else None,
        Coverage.of(possible, counted.combinations, len(labels.predicted_rooms), rate),
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


class _Counting:
    """Goes through the stages as a build does, and counts sentences where that would score them.

    A sentence without a score stands in the tables as if its log probability were 0: what follows
    from it is not counted on.
    """

    def __init__(self, work: Workspace, inputs: Inputs, cache: SentenceCache | None) -> None:
        self._work = work
        self._inputs = inputs
        self._cache = cache
        self._refresh = inputs.config.full_refresh
        self._sentences = dict.fromkeys(ASKING, 0)
        self._unscored = work.table("unscored", "select null::varchar as sentence where false")

    def run(self, stages: tuple[Stage, ...]) -> _Counted:
        tables = Tables(self._work, self._inputs, self._single_scores)
        exact = True
        for stage in stages:
            if stage.name == QUERY_SCORES:
                exact = self._count_queries(tables, stage)
            elif stage.name != LOOKUP:
                tables.make(stage)
        return _Counted(self._sentences, exact, self._work.count(tables[QUERIES]))

    def _single_scores(self, asked: WorkTable) -> WorkTable:
        """Count the single-object sentences to score; the scores there are, and stand-ins."""
        if self._cache is None or not self._work.count(asked):
            return self._work.view("sentence_scores", NO_SCORES)
        needed = self._work.table("needed", f"select distinct sentence from {asked}")
        self._unscored = missing_sentences(self._work, needed, self._cache)
        counted = needed if self._refresh else self._unscored
        self._sentences[SENTENCE_SCORES] = self._work.count(counted)
        return self._work.view(
            "sentence_scores",
            f"from ({self._cache.select()}) "
            f"union all select null, sentence, 0, 1 from {self._unscored}",
        )

    def _count_queries(self, tables: Tables, stage: Stage) -> bool:
        """Count the query sentences to score; whether the count is exact.

        Where an object has no entropy of source ``proxy`` yet, the order of its combinations is
        unknown: each of their sentences is counted as one to score.
        """
        work, cache, reads = self._work, self._cache, tables.reads(stage)
        if cache is None or not work.count(tables[QUERIES]):
            return True
        unranked = (
            f"select distinct object from {tables['single_sentences']} "
            f"semi join {self._unscored} using (sentence)"
        )
        undecided = work.table(
            "undecided",
            f"select source, key from {tables[QUERIES]} where source = {literal(PROXY)} "
            f"and list_has_any(objects, (select coalesce(list(object), []) from ({unranked})))",
        )
        sentences = query_sentences(work, reads)
        parts = {
            kind: work.table(
                f"{kind}_sentences",
                f"select distinct sentence from {new_sentences(work, part, reads)}",
            )
            for kind, part in (
                ("decided", self._part(sentences, "anti", undecided)),
                ("unordered", self._part(sentences, "semi", undecided)),
            )
        }
        unordered = work.count(parts["unordered"])
        missing = {kind: missing_sentences(work, part, cache) for kind, part in parts.items()}
        known = parts["decided"] if self._refresh else missing["decided"]
        self._sentences[QUERY_SCORES] = unordered + work.count(known)
        if not work.count(undecided):
            return True
        one_source = self._inputs.counts is None and self._inputs.config.combinations == ALL
        return one_source and unordered == work.count(missing["unordered"])

    def _part(self, sentences: WorkTable, kind: str, undecided: WorkTable) -> WorkTable:
        return self._work.view(
            f"{kind}_{sentences.name}",
            f"select * from {sentences} {kind} join {undecided} using (source, key)",
        )
