"""How many sentences a build would score: at most so many, or exactly what the cache lacks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from roomtables.config import ALL, MISSES, NONE
from roomtables.labels import ObjectLabel
from roomtables.offline.causes import Comparison, Made
from roomtables.offline.inputs import Inputs
from roomtables.offline.stages import (
    ASKING,
    CACHED,
    QUERIES,
    QUERY_SCORES,
    SENTENCE_SCORES,
    Stage,
    StageState,
)
from roomtables.offline.tables import Tables
from roomtables.offline.workspace import Workspace, WorkTable, workspace
from roomtables.schemas import GROUND_TRUTH, PROXY, Column, literal
from roomtables.sentences import Template
from roomtables.storage.manifest import Manifest, count_combinations
from roomtables.storage.score_cache import NO_SCORES, SentenceCache
from roomtables.storage.scratch import scratch
from roomtables.storage.versions import Version

# More combinations than this are counted by formula only: each would have to be written out.
MOST_COUNTED = 10_000_000
_PLACE = "\0"  # where objects or the room stand; no label holds a NUL
_PHRASE = (Column("phrase", "varchar", "a predicted room, with its article"),)


@dataclass(frozen=True)
class Counted:
    """Sentences to score, by stage; whether that is exact; and the combinations that are asked.

    What is not exact is an upper bound.
    """

    sentences: Mapping[str, int]
    exact: bool
    combinations: int

    @property
    def total(self) -> int:
        return sum(self.sentences.values())


def by_formula(
    inputs: Inputs, states: Sequence[StageState], made: Made, kept: Version | None
) -> Counted:
    """At most so many sentences: no table is made, and the cache is not looked into.

    ``kept`` is the published version where the cache holds all its scores: of those sources whose
    sentences cannot have changed its combinations count as held.
    """
    labels = inputs.labels
    state = {found.stage: found.state for found in states}
    sentences = dict.fromkeys(ASKING, 0)
    if inputs.scores is None and state[SENTENCE_SCORES] != CACHED:
        templates = len(inputs.config.template)
        sentences[SENTENCE_SCORES] = templates * len(labels.objects) * len(labels.rooms)
    compared = Comparison(Made.of(kept), made) if kept else None
    sources = [PROXY] if inputs.counts is None else [PROXY, GROUND_TRUTH]
    if state[QUERY_SCORES] != CACHED:
        new = 0
        for source in sources:
            keeps = kept and compared and compared.keeps_sentences(source)
            new += _new_combinations(inputs, source, kept.manifest if kept and keeps else None)
        sentences[QUERY_SCORES] = new * len(labels.predicted_rooms)
    combinations = sum(_combinations(inputs, source, 1) for source in sources)
    return Counted(sentences, not any(sentences.values()), combinations)


def _combinations(inputs: Inputs, source: str, least: int) -> int:
    """How many combinations of at least so many objects are asked for, at most."""
    wanted, k = inputs.config.combinations, inputs.config.k
    if wanted == NONE:
        return 0
    if wanted == ALL:
        objects = len(inputs.labels.objects)
        return count_combinations(objects, k) - count_combinations(objects, least - 1)
    sizes = inputs.asked.sizes(source).clip(max=k)
    return int((sizes >= least).sum())


def _new_combinations(inputs: Inputs, source: str, published: Manifest | None) -> int:
    """Of those, how many are not held by the published version, in the order that they have now.

    A combination of one object has the sentences of that object, which the model has scored for
    the co-occurrence unless other scores stand in for the model's.
    """
    config = inputs.config
    least = 2 if inputs.scores is None else 1
    needed = _combinations(inputs, source, least)
    if published is None or source not in published.combinations:
        return needed
    if config.combinations == ALL and published.settings.combinations == ALL:
        objects, k = len(inputs.labels.objects), min(config.k, published.settings.k)
        return needed - count_combinations(objects, k) + count_combinations(objects, least - 1)
    if config.k < published.settings.k:
        return needed
    if config.combinations == MISSES:
        return min(needed, inputs.asked.new.get(source, 0))
    if config.combinations == ALL:
        singles = len(inputs.labels.objects) if least == 2 else 0
        return needed - max(0, published.combinations[source] - singles)
    return needed


def by_cache(inputs: Inputs, cache: SentenceCache | None, stages: Sequence[Stage]) -> Counted:
    """What a build would score, by what the cache lacks; an upper bound where that cannot be known.

    Which sentences are asked depends on scores that are still to come where an object has none
    yet: they rank the objects, and the sentence names them by rank.
    """
    with scratch("plan") as folder, workspace(folder) as work:
        return _Counting(work, inputs, cache).run(stages)


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
        self._unranked = work.table("unranked", "select null::varchar as object where false")

    def run(self, stages: Sequence[Stage]) -> Counted:
        tables = Tables(self._work, self._inputs, self._single_scores)
        exact = True
        for stage in stages:
            if stage.name == QUERY_SCORES:
                exact = self._count_queries(tables)
                break  # the lookup asks nothing
            tables.make(stage)
        return Counted(self._sentences, exact, self._work.count(tables[QUERIES]))

    def _single_scores(self, asked: WorkTable) -> WorkTable:
        """Count the single-object sentences to score; the scores there are, and stand-ins."""
        work = self._work
        if self._cache is None or not work.count(asked):
            return work.view("sentence_scores", NO_SCORES)
        cached = self._cache.select()
        held = work.table("held", f"from ({cached}) semi join {asked} using (sentence)")
        lacking = f"select distinct sentence from {asked} anti join {held} using (sentence)"
        unscored = work.table("unscored", lacking)
        counted = f"(select distinct sentence from {asked})" if self._refresh else unscored
        self._sentences[SENTENCE_SCORES] = self._count(f"from {counted}")
        self._unranked = work.table(
            "unranked",
            f"select distinct object from {asked} semi join {unscored} using (sentence)",
        )
        return work.view(
            "sentence_scores",
            f"from {held} union all select null, sentence, 0, 1 from {unscored}",
        )

    def _count_queries(self, tables: Tables) -> bool:
        """Count the query sentences to score; whether the count is exact.

        A combination with an object that has no entropy yet, whose place in the sentence is
        unknown, counts as if none of its sentences were held.
        """
        work, singles, queries = self._work, tables["single_sentences"], tables[QUERIES]
        if self._cache is None or not work.count(queries):
            return True
        rooms = [room.phrase for room in self._inputs.labels.predicted_rooms]
        phrases = work.load("phrases", _PHRASE, {"phrase": rooms})
        unranked = f"(select coalesce(list(object), []) from {self._unranked})"
        frames = work.table(
            "frames",
            f"select before_room, after_room, bool_or(source = {literal(PROXY)} "
            f"and list_has_any(objects, {unranked})) as undecided "
            f"from {queries} group by before_room, after_room",
        )
        asked = (
            "select before_room || phrase || after_room as sentence, undecided "
            f"from {frames} cross join {phrases}"
        )
        new = f"from ({asked}) anti join {singles} using (sentence)"
        held = f"({self._cache.select()})"
        missing = new if self._refresh else f"{new} anti join {held} as held using (sentence)"
        undecided = self._count(f"{new} where undecided")
        decided = self._count(f"{missing} where not undecided")
        self._sentences[QUERY_SCORES] = undecided + decided
        return not undecided or self._order_is_irrelevant(singles, queries, held)

    def _order_is_irrelevant(self, singles: WorkTable, queries: WorkTable, held: str) -> bool:
        """Whether a combination costs the same whatever place its objects without entropy have.

        It does where each is one sentence per room, of one source, of no more objects than asked
        for, and the cache holds no sentence that names one of those objects beside others.
        """
        work, inputs = self._work, self._inputs
        if work.rows(f"select count(distinct source) > 1 from {queries}")[0][0]:
            return False
        if inputs.asked.sizes(PROXY).max(initial=0) > inputs.config.k:
            return False
        unranked = {label for (label,) in work.rows(f"from {self._unranked}")}
        said = [re.escape(o.plural) for o in inputs.labels.objects if o.label in unranked]
        alike = [
            f"regexp_full_match(sentence, {literal(_form(inputs.config.template[0]))})",
            f"regexp_matches(sentence, {literal('|'.join(said))})",
        ]
        others = f"from {held} anti join {singles} using (sentence)"
        return not work.rows(f"select 1 {others} where {' and '.join(alike)} limit 1")

    def _count(self, selected: str) -> int:
        return int(self._work.rows(f"select count(*) {selected}")[0][0])


def _form(template: str) -> str:
    """A regular expression of the sentences of a template, whatever their objects and room."""
    objects = ObjectLabel("", _PLACE)
    around = _PLACE.join(Template(template).around_room([objects]))
    return ".*".join(map(re.escape, around.split(_PLACE)))
