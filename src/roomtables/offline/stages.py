"""The stages of a build, as ``build.toml`` lists them: their order, and what each one reads.

A stage is handed what the file says it reads (earlier stages, settings, input files) and nothing
else; the same list decides what makes its table stale.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from roomtables.config import MISSES, BuildConfig, default_stages, pipeline_folder
from roomtables.errors import ConfigError, StoreError
from roomtables.offline.causes import Comparison, Made, joined
from roomtables.offline.inputs import INPUTS, Inputs
from roomtables.offline.label_changes import Labels
from roomtables.storage.manifest import SchemaVersionError
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import LOOKUP, SpaceFolder, Version

SENTENCE_SCORES, QUERIES, QUERY_SCORES = "sentence_scores", "queries", "query_scores"
STAGES = (
    "objects", "rooms", "names", SENTENCE_SCORES, "cooccurrence", "entropy", "room_bias", QUERIES,
    QUERY_SCORES, LOOKUP,
)  # fmt: skip
# The stages that ask the language model.
ASKING = (SENTENCE_SCORES, QUERY_SCORES)
CACHED, MISSING, STALE = "cached", "missing", "stale"
NOT_BUILT, SCORE_PART_MISSING = "not built", "score part missing"


class Stage(NamedTuple):
    """A stage: the table that it makes, and what it reads for that."""

    name: str
    reads: tuple[str, ...]


def listed_stages(config: BuildConfig) -> tuple[Stage, ...]:
    """The stages in the order of the settings, or of the package's ``build.toml``.

    Raises
    ------
    ConfigError
        A stage is unknown or missing, or reads what is neither a stage before it, a setting, nor
        an input file.
    """
    listed = config.stages or default_stages()
    stages = tuple(Stage(name, reads) for name, reads in listed.items())
    for name in STAGES:
        if name not in listed:
            raise ConfigError(f"build.toml: stage `{name}` is missing from `[stages]`; add it")
    for place, stage in enumerate(stages):
        if stage.name not in STAGES:
            raise ConfigError(
                f"build.toml: there is no stage `{stage.name}`; the stages are {', '.join(STAGES)}"
            )
        before = {earlier.name for earlier in stages[:place]}
        for read in stage.reads:
            if read not in before | INPUTS | BuildConfig.recorded_names():
                raise ConfigError(
                    f"build.toml: stage `{stage.name}` reads `{read}`, which is no stage before "
                    "it, no setting and no input file"
                )
    return stages


def stage_sql(stage: str) -> str | None:
    """The SELECT that is a stage's table; ``None`` for a stage that Python makes."""
    path = pipeline_folder() / f"{stage}.sql"
    return path.read_text(encoding="utf-8") if path.is_file() else None


def recorded_reads(
    stages: tuple[Stage, ...], inputs: Inputs, scorer_id: str | None
) -> dict[str, dict[str, Any]]:
    """What each stage reads, as a manifest records it.

    Settings by value, input files by hash, the model by its scorer id, earlier stages by the hash
    of their own record, and the stage's SQL by its hash, under the name of its file. A table is up
    to date when this is what the published manifest holds.
    """
    found: dict[str, dict[str, Any]] = {}
    for stage in stages:
        reads = {read: _recorded(stage, read, found, inputs, scorer_id) for read in stage.reads}
        sql = stage_sql(stage.name)
        if sql is not None:
            reads[f"{stage.name}.sql"] = _hash(sql)
        found[stage.name] = reads
    return found


def fingerprint(recorded: Mapping[str, Mapping[str, Any]]) -> str:
    """One hash over all stages: what names a version."""
    return _hash(recorded)


def made_from(stages: tuple[Stage, ...], inputs: Inputs, scorer_id: str | None) -> Made:
    """What a build with these inputs makes its tables from."""
    asked = inputs.asked.new.values()
    return Made(
        recorded_reads(stages, inputs, scorer_id),
        inputs.config,
        lambda: Labels.of_space(inputs.labels),
        as_published=inputs.config.combinations == MISSES and not any(asked),
    )


@dataclass(frozen=True)
class StageState:
    """A stage's state before a build.

    ``why`` says what changed, as a person would: "k 3 → 2", "entropy.sql changed", "score part
    missing"; empty where the stage is cached.
    """

    stage: str
    state: str
    why: str = ""
    sentences: int = 0


def decide(
    made: Made,
    published: Version | None,
    cache: SentenceCache | None,
    full_refresh: bool,
    not_built: str = NOT_BUILT,
) -> list[StageState]:
    """The state of every stage; a build makes all tables unless every stage is cached.

    Parameters
    ----------
    made : what a build now makes its tables from
    cache : ``None`` where no model is asked
    not_built : why there is no published version, where there is none
    """
    if full_refresh:
        return [StageState(stage, STALE, "full refresh") for stage in made.stages]
    if published is None:
        return [StageState(stage, MISSING, not_built) for stage in made.stages]
    compared = Comparison(Made.of(published), made)
    damaged = _damaged(published)
    kept = is_kept(published, cache)
    causes: dict[str, list[str]] = {}
    found = []
    for stage, reads in made.stages.items():
        inherited = [cause for read in reads for cause in causes.get(read, ())]
        causes[stage] = [*compared.causes(stage).values(), *inherited]
        if causes[stage]:
            found.append(StageState(stage, STALE, joined(causes[stage]) or "other inputs"))
        elif stage in damaged or (stage in ASKING and not kept):
            found.append(StageState(stage, MISSING, damaged.get(stage, SCORE_PART_MISSING)))
        else:
            found.append(StageState(stage, CACHED))
    return found


def is_kept(published: Version, cache: SentenceCache | None) -> bool:
    """Whether the cache holds all the scores that a version was made from."""
    return cache is None or cache.holds(published.manifest.score_parts)


def why_not_built(space: SpaceFolder) -> str:
    """Why a build finds no published version: nothing is there, or it cannot be used."""
    try:
        space.current()
    except StoreError as error:
        if isinstance(error.__cause__, SchemaVersionError):
            return "made by another roomtables"
    return "published version unusable" if space.pointer() else NOT_BUILT


def _damaged(version: Version) -> dict[str, str]:
    """Stages whose published files are not as noted, and how."""
    return {
        Path(name).stem if name.endswith(".parquet") else LOOKUP: (
            f"{name} {'missing' if how == 'removed' else how}"
        )
        for name, how in version.damaged_files()
    }


def _recorded(
    stage: Stage,
    read: str,
    before: Mapping[str, Mapping[str, Any]],
    inputs: Inputs,
    scorer_id: str | None,
) -> Any:
    if read in before:
        return _hash(before[read])
    if read == "model":
        return scorer_id if inputs.asks(stage.name) else None
    return inputs.recorded(read)


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
