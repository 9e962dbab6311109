"""The build: labels → sentences → scores → co-occurrence → entropy → queries → lookup → published.

Everything is written aside; a version appears whole or not at all. What is scored stays in the
sentence cache whatever happens.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import duckdb

from roomtables.config import BuildConfig
from roomtables.offline import stages
from roomtables.offline.engines import score
from roomtables.offline.inputs import Inputs, LazyScorer
from roomtables.offline.plan import CACHED, combined, decide, stage_fingerprints
from roomtables.offline.scoring import Scored, Work, missing_sentences
from roomtables.offline.stages import interruptible
from roomtables.schemas import SCHEMA_VERSION, VERSION_TABLES
from roomtables.scorer import Scorer
from roomtables.storage.files import build_lock, utc_now
from roomtables.storage.lookup_writer import derive_lookup
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version, file_facts


@dataclass(frozen=True)
class BuildReport:
    """What a build did: the version that is published now, and what it cost.

    ``published`` is false where the published version was up to date already.
    """

    labels: str
    version: str
    sentences_scored: int
    sentences_cached: int
    seconds: float
    published: bool

    def as_json(self) -> dict[str, Any]:
        """The report under the contract's keys."""
        return asdict(self)


def build(
    config: BuildConfig | None = None,
    *,
    tables: str | Path = "tables",
    scorer: Scorer | None = None,
    progress: bool = False,
    wait: bool = False,
    **options: Any,
) -> BuildReport:
    """Build and publish the tables of one label space; what is cached is not scored again.

    Parameters
    ----------
    config : the settings; by default the package's ``build.toml``
    tables : the tables folder
    scorer : the language model; by default ``config.model``, loaded when something is to score
    progress : show a progress bar on stderr (a scorer that is handed in shows its own, if any)
    wait : where another process builds in this folder, wait for it instead of refusing
    options : settings by name (``labels="nyuclass"``, ``k=2``) that replace those of ``config``

    Raises
    ------
    RoomtablesError
        Bad input, a model that cannot be loaded, a failed check: nothing is published.
    """
    started = time.monotonic()
    config = replace(config, **options) if config else BuildConfig.load(**options)
    inputs = Inputs.read(config)
    model = LazyScorer(config, scorer)
    with build_lock(Path(tables), wait):
        return _build(inputs, model, Path(tables), progress, started)


def _build(
    inputs: Inputs, model: LazyScorer, tables: Path, progress: bool, started: float
) -> BuildReport:
    """Decide, make, publish; for whoever holds the build lock."""
    scorer_id = model.scorer_id if inputs.needs_model else None
    inputs = inputs.asking(tables)
    fingerprints = stage_fingerprints(inputs, scorer_id)
    space = SpaceFolder(tables, inputs.labels.name)
    space.remove_abandoned()
    cache = open_cache(tables, scorer_id)
    current = space.published()
    decided = decide(fingerprints, current, cache, inputs.config.full_refresh)
    if current and all(stage.state == CACHED for stage in decided):
        inputs.asked.answered()
        return _report(current, 0, started, published=False)
    making = _Making(inputs, model, cache, progress)
    with interruptible(space.path), space.staging() as staging:
        manifest = making.run(staging) | {
            "inputs": combined(fingerprints),
            "stages": {name: found._asdict() for name, found in fingerprints.items()},
            "rate": making.rate(current),
            "created": utc_now(),
            "seconds": round(time.monotonic() - started, 3),
        }
        manifest["model"]["described"] = making.described(current)
        version = space.publish(staging, space.new_name(manifest["inputs"]), manifest)
    inputs.asked.answered()
    space.remove_old()
    return _report(version, version.manifest["sentences_scored"], started, published=True)


def open_cache(tables: Path, scorer_id: str | None) -> SentenceCache | None:
    """The cache of a scorer, tidied: finished parts of a killed build taken in, parts verified.

    Raises
    ------
    StoreError
        A part is damaged; the message names it.
    """
    if scorer_id is None:
        return None
    cache = SentenceCache(tables, scorer_id)
    cache.end_runs()
    cache.verify()
    cache.remove_retired()
    return cache


def _report(version: Version, scored: int, started: float, published: bool) -> BuildReport:
    return BuildReport(
        version.manifest["labels"],
        version.name,
        scored,
        version.manifest["sentences"] - scored,
        round(time.monotonic() - started, 3),
        published,
    )


@dataclass
class _Making:
    """A version in the making: what it reads, whom it asks, what it has counted so far."""

    inputs: Inputs
    model: LazyScorer
    cache: SentenceCache | None
    progress: bool
    sentences: int = 0
    scored: Scored = field(default_factory=Scored)

    def run(self, staging: Path) -> dict[str, Any]:
        """Make, check and write every table in ``staging``; returns the manifest's content."""
        connection = stages.connect(staging)
        try:
            self._make_tables(connection)
            stages.run_checks(connection)
            rows = {name: stages.export(connection, name, staging) for name in VERSION_TABLES}
            lookup = derive_lookup(
                connection,
                staging,
                staging / LOOKUP,
                self.inputs.labels,
                self._sentence_settings(),
            )
            combinations = connection.execute(
                "select source, count(key) from (select distinct source from cooccurrence) "
                "left join query_scores using (source) group by source order by source"
            ).fetchall()
        finally:
            connection.close()
        stages.remove_workspace(staging)
        files = sorted(path for path in staging.rglob("*") if path.is_file())
        return (
            self._manifest()
            | lookup
            | {
                "rows": rows,
                "combinations": dict(combinations),
                "files": {path.relative_to(staging).as_posix(): file_facts(path) for path in files},
            }
        )

    def _make_tables(self, connection: duckdb.DuckDBPyConnection) -> None:
        """All tables, in the order of the stages."""
        stages.prepare(connection, self.inputs)
        if self.inputs.scores is None:
            self._score(connection, stages.SINGLES)
        stages.derive(connection, self.inputs)
        if self.inputs.config.combinations != "none":
            self._score(connection, stages.QUERIES)
        stages.run_stage(connection, "query_scores")

    def _score(self, connection: duckdb.DuckDBPyConnection, sentences: str) -> None:
        """See that every sentence that is selected is in view ``sentence_scores``."""
        assert self.cache is not None  # whoever needs a sentence needs a model
        self.sentences += stages.need(connection, sentences)
        if self.inputs.config.full_refresh:
            self.cache.evict(connection, "needed")
        missing = missing_sentences(connection, self.cache, "needed")
        if missing:
            work = Work(
                connection, self.cache, self.model, self.inputs.config, missing, self.progress
            )
            self.scored += score(work)
        select = self.cache.select()
        connection.execute(f"create or replace view sentence_scores as {select}")

    def rate(self, before: Version | None) -> Mapping[str, Any] | None:
        """What scoring cost, for `plan` to go by: measured now, or noted by the version before."""
        done = self.scored
        if done.sentences and done.seconds > 0:
            return {
                "sentences_per_second": round(done.sentences / done.seconds, 1),
                "tokens_per_sentence": round(done.tokens / done.sentences, 2),
                "sentences": done.sentences,
                "workers": done.workers,
            }
        return self._noted(before, "rate")

    def described(self, before: Version | None) -> Mapping[str, Any]:
        """Provenance of the model; of a model that had nothing to score, what was noted before."""
        return self.model.describe() or (self._noted(before, "model") or {}).get("described", {})

    def _noted(self, before: Version | None, key: str) -> Mapping[str, Any] | None:
        same = before and before.manifest["query_scorer_id"] == self._scorer_id
        return before.manifest.get(key) if before and same else None

    @property
    def _scorer_id(self) -> str | None:
        return self.cache.scorer_id if self.cache else None

    def _sentence_settings(self) -> dict[str, Any]:
        config = self.inputs.config
        return {"k": config.k, "template": config.template, "reduction": config.reduction}

    def _manifest(self) -> dict[str, Any]:
        inputs, config = self.inputs, self.inputs.config
        imported = f"imported-{inputs.scores.fingerprint[:12]}" if inputs.scores else None
        return self._sentence_settings() | {
            "schema_version": SCHEMA_VERSION,
            "labels": inputs.labels.name,
            "labels_fingerprint": inputs.labels.fingerprint,
            "objects": len(inputs.labels.objects),
            "rooms": len(inputs.labels.rooms),
            "predicted_rooms": len(inputs.labels.predicted_rooms),
            "scorer_id": imported or self._scorer_id,
            "query_scorer_id": self._scorer_id,
            "score_parts": [part.name for part in self.cache.parts()] if self.cache else [],
            "model": {n: getattr(config, n) for n in ("model", "revision", "dtype", "scoring")},
            "decision": {
                name: getattr(config, name)
                for name in ("source", "rule", "prior_weight", "evidence_power")
            },
            "smoothing": inputs.smoothing,
            "sentences": self.sentences,
            "sentences_scored": self.scored.sentences,
        }
