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

import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.config import ALL, MISSES, NONE, BuildConfig
from roomtables.labels import LabelSpace, names_of_objects
from roomtables.storage.versions import Version

_NAMED = 3  # labels that are named; the others are counted
_MODEL_SETTINGS = ("model", "revision", "dtype", "device", "scoring")

Stages = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Labels:
    """What a label space says, as far as the tables of a version hold it.

    Attributes
    ----------
    objects : label → plural
    rooms : label → article, and whether it is predicted
    names : every name of an object → its label
    """

    objects: Mapping[str, str]
    rooms: Mapping[str, tuple[str, bool]]
    names: Mapping[str, str]

    @classmethod
    def of_space(cls, space: LabelSpace) -> Labels:
        """Those of a label space."""
        return cls(
            {o.label: o.plural for o in space.objects},
            {r.label: (r.article, r.predicted) for r in space.rooms},
            {name: found.label for name, found in names_of_objects(space.objects).items()},
        )

    @classmethod
    def of_version(cls, version: Version) -> Labels | None:
        """Those of a version; ``None`` where its tables cannot be read."""
        try:
            objects, rooms, names = (
                pq.read_table(version.path / f"{table}.parquet").to_pylist()
                for table in ("objects", "rooms", "names")
            )
            return cls(
                {row["label"]: row["plural"] for row in objects},
                {row["label"]: (row["article"], row["predicted"]) for row in rooms},
                {row["name"]: row["object"] for row in names},
            )
        except (pa.ArrowException, OSError, LookupError):
            return None


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

    def causes(self, stage: str) -> dict[str, str]:
        """By what a stage reads: how it changed. What has the same cause is named once.

        Stages before it are passed over: what they read is what changed.
        """
        was, now = self.before.stages.get(stage), self.after.stages[stage]
        if was is None:
            return {stage: f"stage {stage} is new"}
        found = {
            read: self._said(read, was, now)
            for read in [*now, *(read for read in was if read not in now)]
            if self._differs(stage, read, was, now)
        }
        return {read: said for read, said in found.items() if said} or dict.fromkeys(
            found, "what it reads changed"
        )

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
                return "template changed"
            case "objects.csv" | "rooms.csv":
                return "; ".join(self.of_labels(read)) or f"{read} changed"
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
    def labels(self) -> tuple[Labels, Labels] | None:
        """The two label spaces; ``None`` where one cannot be read."""
        before, after = self.before.read_labels(), self.after.read_labels()
        return (before, after) if before and after else None

    @cached_property
    def same_objects(self) -> dict[str, str]:
        """Objects that bear another label now, which is among their names: old → new label."""
        if self.labels is None:
            return {}
        before, after = self.labels
        came = set(after.objects) - set(before.objects)
        found: dict[str, str] = {}
        for old in sorted(set(before.objects) - set(after.objects)):
            by_name = {new for new in came if before.names.get(new) == old}
            for new in sorted({after.names.get(old, ""), *by_name} & came - set(found.values())):
                found.setdefault(old, new)
        return found

    @property
    def renamed_objects(self) -> dict[str, str]:
        """The same; and where one went and one came, it is taken for that one renamed."""
        if self.same_objects or self.labels is None:
            return self.same_objects
        return _only_one(self.labels[0].objects, self.labels[1].objects)

    @cached_property
    def renamed_rooms(self) -> dict[str, str]:
        """A room that went and the one that came instead: old label → new label."""
        return _only_one(self.labels[0].rooms, self.labels[1].rooms) if self.labels else {}

    def of_labels(self, file: str) -> list[str]:
        """How ``objects.csv`` or ``rooms.csv`` changed."""
        if self.labels is None:
            return []
        before, after = self.labels
        if file == "rooms.csv":
            said = _of_set("room", before.rooms, after.rooms, self.renamed_rooms)
            return said or _of_rooms(before.rooms, after.rooms)
        said = _of_set("object", before.objects, after.objects, self.renamed_objects)
        if said:
            return said
        plurals = [o for o in after.objects if after.objects[o] != before.objects[o]]
        if plurals:
            return [f"plural of {_few(plurals)} changed"]
        names = before.names.items() ^ after.names.items()
        return [f"synonyms of {_few({label for _, label in names})} changed"] if names else []

    def _of_any_labels(self) -> str:
        return "; ".join([*self.of_labels("objects.csv"), *self.of_labels("rooms.csv")])

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
            return ""  # imported scores or no combinations: named already
        names = [scorer_id.partition("@")[0] for scorer_id in (before, after)]
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
    distinct = list(dict.fromkeys(causes))
    more = len(distinct) - _NAMED
    return "; ".join([*distinct[:_NAMED], *([f"{more} more"] if more > 0 else [])])


def _only_one(before: Iterable[str], after: Iterable[str]) -> dict[str, str]:
    """The label that went and the one that came, where there is one of each."""
    gone, came = set(before) - set(after), set(after) - set(before)
    return dict(zip(gone, came, strict=True)) if len(gone) == len(came) == 1 else {}


def _of_set(
    kind: str, before: Iterable[str], after: Iterable[str], renames: Mapping[str, str]
) -> list[str]:
    came = set(after) - set(before) - set(renames.values())
    gone = set(before) - set(after) - set(renames)
    if len(renames) > 1:
        return [f"{len(renames):,} {kind}s renamed", *_of_set(kind, gone, came, {})]
    said = [f"{kind} {old} renamed to {new}" for old, new in renames.items()]
    for labels, how in ((came, "added"), (gone, "removed")):
        if labels:
            said.append(f"{kind}{'s' if len(labels) > 1 else ''} {_few(labels)} {how}")
    return said


def _of_rooms(
    before: Mapping[str, tuple[str, bool]], after: Mapping[str, tuple[str, bool]]
) -> list[str]:
    """How the rows of the same rooms changed."""
    said = []
    for predicted, how in ((True, "predicted"), (False, "no longer predicted")):
        rooms = [r for r, row in after.items() if row[1] is predicted is not before[r][1]]
        if rooms:
            said.append(f"room{'s' if len(rooms) > 1 else ''} {_few(rooms)} {how}")
    articles = [r for r, row in after.items() if row[0] != before[r][0]]
    if articles:
        said.append(f"article of {_few(articles)} changed")
    return said


def _few(labels: Iterable[str]) -> str:
    shown = sorted(labels)
    more = len(shown) - _NAMED
    return ", ".join(shown[:_NAMED]) + (f" and {more:,} more" if more > 0 else "")


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
