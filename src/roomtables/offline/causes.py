"""Why tables change, as a person would say it: "template changed", "k 3 → 2", "counts.csv changed".

Two lists of what tables are made from are compared: of two versions, or of a version and of what
the next build would read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from roomtables.config import ALL, MISSES, NONE, BuildConfig
from roomtables.offline.label_changes import LabelChanges, Labels
from roomtables.schemas import GROUND_TRUTH, PROXY
from roomtables.scorer import scored_by
from roomtables.storage.versions import Version

_NAMED = 3  # causes that are named; the others are counted
_MODEL_SETTINGS = ("model", "revision", "dtype", "device", "scoring")

_ALL_SOURCES = {"rooms.csv", "cooccurrence", "cooccurrence.sql", "entropy", "entropy.sql"}
# What decides the probabilities and entropies of a source, under the names that stages read it.
DECIDES: Mapping[str, frozenset[str]] = {
    PROXY: frozenset(
        _ALL_SOURCES | {"objects.csv", "template", "scored", "scores", "model", "reduction"}
    ),
    GROUND_TRUTH: frozenset(_ALL_SOURCES | {"counts", "smoothing"}),
}
# What decides the query sentences of a combination in the order that its objects have, and who
# scores them.
_SENTENCES = {"objects.csv", "rooms.csv", "template", "scored", "model"}

Stages = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Made:
    """What tables are made from.

    Attributes
    ----------
    stages : per stage, what it reads, as a manifest records it
    read_labels : reads the label space; ``None`` where that is not possible any more
    as_published : whether the combinations are those that are published already, no other ones
    """

    stages: Stages
    settings: BuildConfig
    read_labels: Callable[[], Labels | None]
    as_published: bool = False

    @classmethod
    def of(cls, version: Version) -> Made:
        """What a version was made from."""
        manifest = version.manifest
        return cls(manifest.stages, manifest.settings, lambda: Labels.of_version(version))


class Comparison:
    """What differs between two lists of what tables are made from."""

    def __init__(self, before: Made, after: Made) -> None:
        self.before = before
        self.after = after

    def keeps_sentences(self, source: str) -> bool:
        """Whether a combination of a source has the query sentences that it had before."""
        changed = {read for stage in self.after.stages for read in self.causes(stage)}
        return not changed & (DECIDES[source] | _SENTENCES)

    def causes(self, stage: str) -> dict[str, str]:
        """How what a stage reads changed, by the name under which it reads it.

        Stages before it are passed over: what they read is what changed. Empty is what follows from
        another change.
        """
        was, now = self.before.stages.get(stage), self.after.stages[stage]
        if was is None:
            return {stage: f"stage {stage} is new"}
        return {
            read: self._said(read, was, now)
            for read in [*now, *(read for read in was if read not in now)]
            if self._differs(stage, read, was, now)
        }

    def _differs(
        self, stage: str, read: str, was: Mapping[str, Any], now: Mapping[str, Any]
    ) -> bool:
        if read in was and read in now and was[read] == now[read]:
            return False
        if read in now and read in was and read in self.after.stages:
            return False
        return not (self.after.as_published and read in {"asked", "combinations"})

    def _said(self, read: str, was: Mapping[str, Any], now: Mapping[str, Any]) -> str:
        if read.endswith(".sql"):
            return f"{read} changed"
        if read not in was or read not in now:
            return "[stages] of build.toml changed"
        before, after = was[read], now[read]
        match read:
            case "template":
                return _of_templates(before, after)
            case "objects.csv":
                said = self.labels.of_objects() if self.labels else []
                return "; ".join(said) or f"{read} changed"
            case "rooms.csv":
                said = self.labels.of_rooms() if self.labels else []
                return "; ".join(said) or f"{read} changed"
            case "counts" | "scores":
                return self._of_file(read, before, after)
            case "model":
                return self._of_model(before, after)
            case "asked":
                return self._of_asked(before, after)
            case "smoothing" if self.before.settings.smoothing == self.after.settings.smoothing:
                return self._of_any_labels()  # 1 / rooms
        return f"{read} {_short(before)} → {_short(after)}"

    @cached_property
    def labels(self) -> LabelChanges | None:
        """How the label space changed; ``None`` where one of the two cannot be read."""
        before, after = self.before.read_labels(), self.after.read_labels()
        return LabelChanges(before, after) if before and after else None

    def _of_any_labels(self) -> str:
        labels = self.labels
        return "; ".join([*labels.of_objects(), *labels.of_rooms()]) if labels else ""

    def _of_file(self, read: str, before: Any, after: Any) -> str:
        """Counts or scores: hashed pair by pair, so that another label space changes them, too."""
        was, now = (getattr(made.settings, read) for made in (self.before, self.after))
        if before is None or after is None:
            return f"{_short(now)} added" if before is None else f"{_short(was)} left out"
        reductions = self.before.settings.reduction, self.after.settings.reduction
        if read == "scores" and reductions[0] != reductions[1]:
            return f"reduction {reductions[0]} → {reductions[1]}"
        return self._of_any_labels() or f"{_short(now)} changed"

    def _of_model(self, before: str | None, after: str | None) -> str:
        if before is None or after is None:
            return ""  # scores that stand in for it, or combinations: named where they are read
        models = [scored_by(scorer_id) for scorer_id in (before, after)]
        if models[0] == models[1]:
            return ""  # named as `scored`
        names = [model.partition("@")[0] for model in models]
        if names[0] != names[1]:
            return f"model {names[0]} → {names[1]}"
        for name in _MODEL_SETTINGS:
            was, now = (getattr(made.settings, name) for made in (self.before, self.after))
            if was != now:
                return f"{name} {_short(was)} → {_short(now)}"
        return f"{names[0]}: weights, tokenizer or device changed"

    def _of_asked(self, before: Sequence[str], after: Sequence[str]) -> str:
        kind = self.after.settings.combinations
        if kind in {ALL, NONE} or self.before.settings.combinations != kind:
            return ""  # named as `combinations`
        if kind != MISSES and before[0] != after[0]:
            return self._of_any_labels() or f"{_short(kind)} changed"
        new = _rows(after) - _rows(before)
        if new > 0:
            return f"{new:,} new miss{'es' if new > 1 else ''}"
        return self._of_any_labels() or "misses changed"


def joined(causes: Iterable[str]) -> str:
    """Causes as one text, each once; those beyond a few are counted."""
    distinct = [cause for cause in dict.fromkeys(causes) if cause]
    more = len(distinct) - _NAMED
    return "; ".join([*distinct[:_NAMED], *([f"{more} more"] if more > 0 else [])])


def _of_templates(before: Sequence[str], after: Sequence[str]) -> str:
    """How the list of templates changed; the first of them makes the query sentence."""
    came, gone = len(set(after) - set(before)), len(set(before) - set(after))
    if not came and not gone:
        return "templates in another order"
    if (came and gone) or before[0] != after[0]:
        return f"template{'s' * (max(len(before), len(after)) > 1)} changed"
    number, how = (came, "added") if came else (gone, "removed")
    return f"template {how}" if number == 1 else f"{number} templates {how}"


def _short(value: object) -> str:
    """A setting; of a path its last part."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    return Path(text).name or text


def _rows(asked: Sequence[str]) -> int:
    """How many combinations a record of what was asked for counts, over all sources."""
    return sum(int(shape[1]) for line in asked[1:] if (shape := re.search(r"\((\d+),", line)))
