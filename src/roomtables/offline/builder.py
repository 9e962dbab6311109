"""The build: labels → sentences → scores → co-occurrence → entropy → queries → lookup → published.

Everything is written aside; a version appears whole or not at all. A build that is killed leaves
the published version as it was, the score parts that it had finished (the next build uses them),
and a folder ``.staging-<process>`` (the next build removes it).
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from roomtables.config import BuildConfig, pipeline_folder
from roomtables.errors import StoreError
from roomtables.offline.causes import Made
from roomtables.offline.engines import score
from roomtables.offline.inputs import Inputs
from roomtables.offline.model import LazyScorer
from roomtables.offline.scoring import Scored, Work, missing_sentences
from roomtables.offline.stages import (
    CACHED,
    Stage,
    decide,
    fingerprint,
    listed_stages,
    made_from,
)
from roomtables.offline.tables import Reads, Tables
from roomtables.offline.workspace import Workspace, WorkTable, workspace
from roomtables.schemas import VERSION_TABLES
from roomtables.scorer import Scorer
from roomtables.storage.checked import note_checked
from roomtables.storage.client_databases import write_anew
from roomtables.storage.derived_lookup import derive_lookup
from roomtables.storage.files import build_lock, utc_now
from roomtables.storage.lookup_writer import LookupSettings
from roomtables.storage.manifest import FileFacts, Manifest, Rate
from roomtables.storage.removal import remove_left, remove_old
from roomtables.storage.samples import write_samples
from roomtables.storage.score_cache import NO_SCORES, SentenceCache
from roomtables.storage.spaces import publish_labels
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version

_SHOWN_ROWS = 3


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
    config = config.changed(**options) if config else BuildConfig.load(**options)
    stages, inputs = listed_stages(config), Inputs.read(config, Path(tables))
    model = LazyScorer(config, scorer)
    with build_lock(Path(tables), wait):
        making = _Making.prepare(stages, inputs.and_misses(Path(tables)), model, Path(tables))
        version = making.published_already()
        if version is None:
            version = making.publish(started, progress)
            remove_old(making.space)
        making.inputs.asked.take_in_misses()
        write_anew(Path(tables))
    return BuildReport(
        version.manifest.labels,
        version.name,
        making.scored.sentences,
        version.manifest.sentences - making.scored.sentences,
        round(time.monotonic() - started, 3),
        published=version != making.current,
    )


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


@dataclass
class _Making:
    """A version in the making, for whoever holds the build lock.

    ``sentences`` counts those that were needed so far, ``scored`` those that had to be scored.
    """

    stages: tuple[Stage, ...]
    made: Made
    inputs: Inputs
    model: LazyScorer
    cache: SentenceCache | None
    space: SpaceFolder
    current: Version | None
    sentences: int = 0
    scored: Scored = field(default_factory=Scored)

    @classmethod
    def prepare(
        cls, stages: tuple[Stage, ...], inputs: Inputs, model: LazyScorer, tables: Path
    ) -> _Making:
        scorer_id = model.scorer_id if inputs.needs_model else None
        made = made_from(stages, inputs, scorer_id)
        space = SpaceFolder(tables, inputs.labels.name)
        remove_left(space)
        cache = open_cache(tables, scorer_id)
        return cls(stages, made, inputs, model, cache, space, space.published())

    def published_already(self) -> Version | None:
        """The published version, where every stage of it is up to date; when that was is noted."""
        refresh = self.inputs.config.full_refresh
        decided = decide(self.made, self.current, self.cache, refresh)
        if self.current is None or any(stage.state != CACHED for stage in decided):
            return None
        note_checked(self.current, utc_now())
        return self.current

    def publish(self, started: float, progress: bool) -> Version:
        """Make every table aside, check them, and publish them as a version."""
        with self.space.staging() as staging:
            with workspace(staging) as work:
                tables = Tables(work, self.inputs, partial(self._score, work, progress))
                for stage in self.stages:
                    if stage.name == LOOKUP:
                        self._write_out(tables, tables.reads(stage), staging)
                    else:
                        tables.make(stage)
                rows = {name: work.count(tables[name]) for name in VERSION_TABLES}
                combinations = work.rows(
                    "select source, count(key) "
                    f"from (select distinct source from {tables['cooccurrence']}) "
                    f"left join {tables['query_scores']} using (source) "
                    "group by source order by source"
                )
            seconds = round(time.monotonic() - started, 3)
            manifest = self._manifest(staging, rows, dict(combinations), seconds)
            name = self.space.new_name(fingerprint(self.made.stages))
            return self.space.publish(staging, name, manifest)

    def _write_out(self, tables: Tables, reads: Reads, staging: Path) -> None:
        """Check the tables, write them, and derive the mapped lookup: the last stage."""
        _run_checks(tables.workspace)
        for name in VERSION_TABLES:
            tables.workspace.export(reads.table(name), staging)
        write_samples(staging)
        publish_labels(self.inputs.labels, staging)
        settings = {name: reads.value(name) for name in LookupSettings._fields}
        derive_lookup(staging, self.inputs.labels, LookupSettings(**settings))

    def _score(self, work: Workspace, progress: bool, asked: WorkTable) -> WorkTable:
        """See that all sentences of a table are in the cache; the view of its scores."""
        needed = work.table(
            "needed", f"select sentence, any_value(start) as start from {asked} group by sentence"
        )
        count = work.count(needed)
        self.sentences += count
        if self.cache is None or not count:
            held = self.cache.select() if self.cache else NO_SCORES
            return work.view("sentence_scores", held)
        config = self.inputs.config
        if config.full_refresh:
            self.cache.evict(work.connection, str(needed))
        missing = missing_sentences(work, needed, self.cache)
        total = work.count(missing)
        if total:
            job = Work(work, missing, self.cache, self.model, config, total, progress, asked.name)
            self.scored += score(job)
        return work.view("sentence_scores", self.cache.select())

    def _manifest(
        self, staging: Path, rows: dict[str, int], combinations: dict[str, int], seconds: float
    ) -> Manifest:
        inputs, labels = self.inputs, self.inputs.labels
        imported = f"imported-{inputs.scores.recorded()[:12]}" if inputs.scores else None
        scorer_id = self.cache.scorer_id if self.cache else None
        files = sorted(path for path in staging.rglob("*") if path.is_file())
        return Manifest(
            labels=labels.name,
            created=utc_now(),
            seconds=seconds,
            settings=inputs.config,
            stages=self.made.stages,
            scorer_id=str(imported or scorer_id),
            query_scorer_id=scorer_id,
            model=self.model.describe() or (self._same_model_before("model") or {}),
            score_parts=tuple(part.name for part in self.cache.parts()) if self.cache else (),
            rate=self._rate() or self._same_model_before("rate"),
            objects=len(labels.objects),
            rooms=len(labels.rooms),
            predicted_rooms=len(labels.predicted_rooms),
            rows=rows,
            combinations=combinations,
            sentences=self.sentences,
            sentences_scored=self.scored.sentences,
            files={path.relative_to(staging).as_posix(): FileFacts.of(path) for path in files},
        )

    def _rate(self) -> Rate | None:
        done = self.scored
        if not done.sentences or done.seconds <= 0:
            return None
        return Rate(
            round(done.sentences / done.seconds, 1),
            round(done.tokens / done.sentences, 2),
            done.sentences,
            done.workers,
        )

    def _same_model_before(self, field_: str) -> Any:
        """What the version before recorded, where the same model had nothing to score now."""
        before, cache = self.current, self.cache
        same = before and cache and before.manifest.query_scorer_id == cache.scorer_id
        return getattr(before.manifest, field_) if before and same else None


def _run_checks(work: Workspace) -> None:
    """Run every ``pipeline/checks/*.sql``; each must return no row.

    Raises
    ------
    StoreError
        A check returned rows; the message names the check and shows the first of them.
    """
    for path in sorted((pipeline_folder() / "checks").glob("*.sql")):
        rows = work.rows(path.read_text(encoding="utf-8"))[:_SHOWN_ROWS]
        if rows:
            raise StoreError(
                f"check {path.stem} failed, so nothing is published; rows: "
                f"{'; '.join(map(str, rows))}; run `roomtables build --full-refresh`"
            )
