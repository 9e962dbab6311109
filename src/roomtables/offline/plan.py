"""What a build would do and why, found out as the build does, without scoring or writing."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import duckdb

from roomtables.config import BuildConfig
from roomtables.offline import stages
from roomtables.offline.combinations import count_all
from roomtables.offline.inputs import Inputs, LazyScorer
from roomtables.offline.scoring import missing_sentences
from roomtables.offline.stages import stage_sql
from roomtables.schemas import PROXY, SCHEMA_VERSION
from roomtables.scorer import Scorer
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version, file_facts


@dataclass(frozen=True)
class Coverage:
    """How much of the label space's combinations a build holds, and what the rest would take.

    ``seconds`` (of scoring) is ``None`` where no build of this model has been timed.
    """

    combinations: int
    asked: int
    rest_sentences: int
    rest_seconds: float | None


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
    stages: tuple[Stage, ...]
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
    sentences: int
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
    config = replace(config, **options) if config else BuildConfig.load(**options)
    root = Path(tables)
    inputs = Inputs.read(config).asking(root)
    model = LazyScorer(config, scorer)
    cache = SentenceCache(root, model.scorer_id) if inputs.needs_model else None
    if cache:
        cache.verify()
    published = SpaceFolder(root, inputs.labels.name).published()
    fingerprints = stage_fingerprints(inputs, cache.scorer_id if cache else None)
    decided = decide(fingerprints, published, cache, config.full_refresh)
    if published and all(stage.state == CACHED for stage in decided):
        counted = _Counted(0, True, sum(published.manifest["combinations"].values()))
    else:
        counted = _count(inputs, cache)
    return _plan(inputs, cache, published, [_with(stage, counted) for stage in decided], counted)


def _with(stage: Stage, counted: _Counted) -> Stage:
    """The sentences' stage, by what the cache lacks, whatever it was published with."""
    if stage.stage != "sentence_scores" or stage.why == "refresh":
        found = stage.stage == "sentence_scores"
        return replace(stage, sentences=counted.sentences if found else 0)
    if not counted.sentences:
        return replace(stage, state=CACHED, why="")
    if stage.state == CACHED:
        return replace(stage, state=MISSING, why="removed", sentences=counted.sentences)
    return replace(stage, sentences=counted.sentences)


def _plan(
    inputs: Inputs,
    cache: SentenceCache | None,
    published: Version | None,
    found: list[Stage],
    counted: _Counted,
) -> Plan:
    rate = _rate(cache) if cache else {}
    speed, tokens = rate.get("sentences_per_second"), rate.get("tokens_per_sentence")
    sources = 1 if inputs.counts is None else 2
    possible = sources * count_all(len(inputs.labels.objects), inputs.config.k)
    rest = (possible - counted.combinations) * len(inputs.labels.predicted_rooms)
    return Plan(
        inputs.labels.name,
        published.name if published else None,
        cache.scorer_id if cache else None,
        tuple(found),
        counted.sentences,
        counted.exact,
        round(counted.sentences * tokens) if tokens else None,
        speed,
        round(counted.sentences / speed, 1) if speed else None,
        Coverage(possible, counted.combinations, rest, round(rest / speed, 1) if speed else None),
    )


def _rate(cache: SentenceCache) -> Mapping[str, Any]:
    """What the newest build of this model measured, whatever its label space."""
    tables = cache.folder.parents[1]
    rates = [
        (version.manifest["created"], version.manifest["rate"])
        for folder in sorted(tables.glob("[!.]*"))
        if (version := SpaceFolder(tables, folder.name).published())
        and version.manifest["query_scorer_id"] == cache.scorer_id
        and version.manifest.get("rate")
    ]
    return dict(max(rates, key=lambda rate: rate[0])[1]) if rates else {}


def _count(inputs: Inputs, cache: SentenceCache | None) -> _Counted:
    """Go through the build's steps in a workspace of the system's temporary folder."""
    with tempfile.TemporaryDirectory(prefix="roomtables-plan-") as folder:
        connection = stages.connect(Path(folder))
        try:
            stages.prepare(connection, inputs)
            singles = _count_singles(connection, inputs, cache)
            stages.derive(connection, inputs)
            combinations = stages.count(connection, "combinations")
            if cache is None or not combinations:
                return _Counted(singles, True, combinations)
            queries, exact = _count_queries(connection, inputs, cache)
            return _Counted(singles + queries, exact, combinations)
        finally:
            connection.close()


def _count_singles(
    connection: duckdb.DuckDBPyConnection, inputs: Inputs, cache: SentenceCache | None
) -> int:
    """Single-object sentences to score; objects that lack one go to table ``unknown``.

    A sentence without a score stands in the tables as if its log probability were 0: what follows
    from it is not counted on.
    """
    connection.execute("create temp table unknown (object varchar)")
    if cache is None or inputs.scores is not None:
        return 0
    needed = stages.need(connection, stages.SINGLES)
    missing = missing_sentences(connection, cache, "needed")
    connection.execute(
        "insert into unknown select distinct object from single_sentences "
        "semi join todo using (sentence)"
    )
    connection.execute("create temp table stand_in as from todo")
    connection.execute(
        f"create or replace view sentence_scores as from ({cache.select()}) union all "
        "select null, sentence, 0, 1 from temp.stand_in"
    )
    return needed if inputs.config.full_refresh else missing


def _count_queries(
    connection: duckdb.DuckDBPyConnection, inputs: Inputs, cache: SentenceCache
) -> tuple[int, bool]:
    """Query sentences to score, and whether that is exact.

    Where a proxy's object has no entropy yet, the order of its combinations is unknown: each of
    their sentences is counted as one to score.
    """
    connection.execute(
        f"create temp table undecided as select source, key from combinations where source = "
        f"'{PROXY}' and list_has_any(objects, (select coalesce(list(object), []) from unknown))"
    )
    known = f"({stages.QUERIES}) as known"
    undecided = 0
    exact = True
    if stages.count(connection, "undecided"):
        decided = "select * from queries anti join undecided using (source, key)"
        known = f"({stages.QUERIES.replace('queries', f'({decided})', 1)}) as known"
        held, undecided = _undecided(connection, cache)
        one_source = inputs.counts is None and inputs.config.combinations == "all"
        exact = one_source and not held
    total = stages.need(connection, f"select sentence from {known}")
    if not inputs.config.full_refresh:
        total = missing_sentences(connection, cache, "needed")
    return total + undecided, exact


def _undecided(connection: duckdb.DuckDBPyConnection, cache: SentenceCache) -> tuple[int, int]:
    """Of the sentences whose order is unknown, how many are held as they stand; all of them."""
    undecided = "select * from queries semi join undecided using (source, key)"
    total = stages.need(connection, stages.QUERIES.replace("queries", f"({undecided})", 1))
    return total - missing_sentences(connection, cache, "needed"), total


CACHED, MISSING, STALE = "cached", "missing", "stale"


@dataclass(frozen=True)
class Stage:
    """A stage's state before a build.

    ``why`` is ``model``, ``code`` or ``input`` (what changed), ``refresh`` (asked for), ``damaged``
    or ``removed`` (a file), or ``not built``; empty where the stage is cached.
    """

    stage: str
    state: str
    why: str = ""
    sentences: int = 0


def decide(
    fingerprints: Mapping[str, Fingerprint],
    published: Version | None,
    cache: SentenceCache | None,
    full_refresh: bool,
) -> list[Stage]:
    """The state of every stage; a build makes all tables unless every stage is cached.

    ``cache`` is ``None`` where no model is asked.
    """
    if full_refresh:
        return [Stage(stage, STALE, "refresh") for stage in fingerprints]
    noted: Mapping[str, Any] = published.manifest.get("stages", {}) if published else {}
    found = [_compare(stage, now, noted, published) for stage, now in fingerprints.items()]
    damaged = _damaged(published) if published else {}
    found = [
        replace(stage, state=MISSING, why=damaged[stage.stage])
        if stage.state == CACHED and stage.stage in damaged
        else stage
        for stage in found
    ]
    recorded = published.manifest.get("score_parts", []) if published else []
    if cache is None or cache.holds(recorded):
        return found
    return [
        replace(stage, state=MISSING, why="removed")
        if (stage.stage, stage.state) == ("sentence_scores", CACHED)
        else stage
        for stage in found
    ]


def _compare(
    stage: str, now: Fingerprint, noted: Mapping[str, Any], published: Version | None
) -> Stage:
    if published is None:
        return Stage(stage, MISSING, "not built")
    before = noted.get(stage, {})
    for why, value in now._asdict().items():
        if before.get(why) != value:
            return Stage(stage, STALE, why)
    return Stage(stage, CACHED)


def _damaged(version: Version) -> dict[str, str]:
    """Stages whose published files are not as noted, and how."""
    found = {}
    for name, noted in version.manifest.get("files", {}).items():
        path = version.path / name
        stage = LOOKUP if name.startswith(f"{LOOKUP}/") else Path(name).stem
        if not path.is_file():
            found[stage] = "removed"
        elif file_facts(path) != noted:
            found[stage] = "damaged"
    return found


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
