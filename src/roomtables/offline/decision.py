"""Which stages a build has to make, and why: what `plan` shows and what `build` obeys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.offline.cache import SentenceCache
from roomtables.offline.fingerprints import Fingerprint
from roomtables.store import LOOKUP, Version, file_facts

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
