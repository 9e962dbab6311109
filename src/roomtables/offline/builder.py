"""The build: labels → sentences → scores → co-occurrence → entropy → queries → lookup → published.

Everything is written aside; a version appears whole or not at all. What is scored stays in the
sentence cache whatever happens.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import duckdb

from roomtables.config import BuildConfig
from roomtables.offline import queries, stages
from roomtables.offline.cache import SentenceCache
from roomtables.offline.inputs import Inputs
from roomtables.offline.model import LazyScorer
from roomtables.offline.scoring import missing_sentences, score_missing
from roomtables.offline.twins import derive_twin
from roomtables.schemas import SCHEMA_VERSION, VERSION_TABLES
from roomtables.scorer import Scorer
from roomtables.store import LOOKUP, SpaceFolder, Version, build_lock, utc_now


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
    **options: Any,
) -> BuildReport:
    """Build and publish the tables of one label space; what is cached is not scored again.

    Parameters
    ----------
    config : the settings; by default the package's ``build.toml``
    tables : the tables folder
    scorer : the language model; by default ``config.model``, loaded when something is to score
    progress : show progress bars on stderr
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
    fingerprint = inputs.fingerprint(model.scorer_id if inputs.needs_model else None)
    root = Path(tables)
    with build_lock(root):
        space = SpaceFolder(root, inputs.labels.name)
        current = space.published()
        if current and current.manifest["inputs"] == fingerprint and not config.full_refresh:
            return _report(current, 0, started, published=False)
        with space.staging() as staging:
            made = _Making(inputs, model, root, progress).run(staging)
            manifest = made | {
                "inputs": fingerprint,
                "created": utc_now(),
                "seconds": round(time.monotonic() - started, 3),
            }
            version = space.publish(staging, space.new_name(fingerprint), manifest)
        space.remove_old()
    return _report(version, version.manifest["sentences_scored"], started, published=True)


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
    tables: Path
    progress: bool
    sentences: int = 0
    scored: int = 0

    def run(self, staging: Path) -> dict[str, Any]:
        """Make, check and write every table in ``staging``; returns the manifest's content."""
        connection = stages.connect(staging)
        try:
            self._make_tables(connection)
            stages.run_checks(connection)
            rows = {name: stages.export(connection, name, staging) for name in VERSION_TABLES}
            derive_twin(connection, staging / LOOKUP, self.inputs.labels, self._sentence_settings())
            combinations = connection.execute(
                "select source, count(key) from (select distinct source from cooccurrence) "
                "left join query_scores using (source) group by source order by source"
            ).fetchall()
        finally:
            connection.close()
        stages.remove_workspace(staging)
        return self._manifest() | {"rows": rows, "combinations": dict(combinations)}

    def _make_tables(self, connection: duckdb.DuckDBPyConnection) -> None:
        """All tables, in the order of the stages."""
        inputs = self.inputs
        stages.load_labels_tables(connection, inputs.labels)
        stages.load_pairs(connection, "counts", "count", inputs.counts)
        stages.load_parameters(
            connection, {"reduction": inputs.config.reduction, "smoothing": inputs.smoothing}
        )
        queries.create_tables(connection)
        if inputs.scores is None:
            queries.load_single_sentences(connection, inputs.labels, inputs.template)
            self._score(connection, "select sentence from single_sentences")
            stages.run_stage(connection, "single_scores")
        else:
            stages.load_pairs(connection, "single_scores", "score", inputs.scores)
        for table in ("cooccurrence", "entropy", "room_bias"):
            stages.run_stage(connection, table)
        if inputs.config.combinations != "none":
            queries.load_queries(connection, inputs)
            self._score(
                connection,
                "select sentence from queries anti join single_sentences using (sentence)",
            )
        stages.run_stage(connection, "query_scores")

    def _score(self, connection: duckdb.DuckDBPyConnection, needed: str) -> None:
        """See that every sentence that ``needed`` selects is in view ``sentence_scores``."""
        cache = SentenceCache(self.tables, self.model.scorer_id)
        connection.execute(
            f"create or replace temp table needed as select distinct * from ({needed})"
        )
        if self.inputs.config.full_refresh:
            cache.evict(connection, "needed")
        missing = missing_sentences(connection, cache, "needed")
        if missing:
            score_missing(connection, cache, self.model.load(), missing, self.progress)
        connection.execute(f"create or replace view sentence_scores as {cache.select()}")
        self.scored += missing
        self.sentences += int(connection.execute("select count(*) from needed").fetchall()[0][0])

    def _sentence_settings(self) -> dict[str, Any]:
        config = self.inputs.config
        return {"k": config.k, "template": config.template, "reduction": config.reduction}

    def _manifest(self) -> dict[str, Any]:
        inputs, config = self.inputs, self.inputs.config
        scorer_id = self.model.scorer_id if inputs.needs_model else None
        imported = f"imported-{inputs.scores.fingerprint[:12]}" if inputs.scores else None
        model = {name: getattr(config, name) for name in ("model", "revision", "dtype", "scoring")}
        return self._sentence_settings() | {
            "schema_version": SCHEMA_VERSION,
            "labels": inputs.labels.name,
            "labels_fingerprint": inputs.labels.fingerprint,
            "objects": len(inputs.labels.objects),
            "rooms": len(inputs.labels.rooms),
            "predicted_rooms": len(inputs.labels.predicted_rooms),
            "scorer_id": imported or scorer_id,
            "query_scorer_id": scorer_id,
            "model": model | {"described": dict(self.model.describe())},
            "decision": {
                name: getattr(config, name)
                for name in ("source", "rule", "prior_weight", "evidence_power")
            },
            "smoothing": inputs.smoothing,
            "sentences": self.sentences,
            "sentences_scored": self.scored,
        }
