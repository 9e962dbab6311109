"""All that a build reads, validated before anything is scored or written."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.config import NONE, BuildConfig
from roomtables.csv_rows import read_csv
from roomtables.errors import InputError
from roomtables.labels import LabelSpace, normalise
from roomtables.limits import FLOAT32_MAX, LARGEST_COUNT
from roomtables.offline.combinations import Asked, check_key_size, resolve
from roomtables.rooms import read_room_lines
from roomtables.storage.spaces import find_labels

log = logging.getLogger(__name__)

Pair = tuple[str, str]
# What a stage may read besides settings and earlier stages: input files, by their content.
INPUTS = frozenset({"objects.csv", "rooms.csv", "counts", "scores", "asked"})


@dataclass(frozen=True)
class Inputs:
    """A build's settings and what their files hold.

    Attributes
    ----------
    config : the settings; ``combinations`` is never ``auto``, so that what is recorded is what was
        built
    counts : times that object and room were seen together; ``None`` where none were given
    scores : S(o, r) in nats that stand in for the model's; ``None`` where none were given
    asked : the combinations that were asked for, where the settings do not want all of them
    """

    config: BuildConfig
    labels: LabelSpace
    counts: PairValues | None
    scores: PairValues | None
    asked: Asked

    @classmethod
    def read(cls, config: BuildConfig, tables: Path = Path("tables")) -> Inputs:
        """Read and validate; a label space may be one that is published under ``tables``.

        Raises
        ------
        RoomtablesError
            A file is missing or malformed, or a setting makes no sense.
        """
        labels = find_labels(config.labels, tables)
        check_key_size(len(labels.objects), config.k)
        sources = 1 if config.counts is None else 2
        wanted = resolve(config.combinations, labels, config.k, sources)
        config = replace(config, combinations=wanted)
        return cls(
            config,
            labels,
            read_counts(config.counts, labels) if config.counts else None,
            read_scores(config.scores, labels, config.reduction) if config.scores else None,
            Asked.by_file(config.combinations, labels),
        )

    def and_misses(self, tables: Path) -> Inputs:
        """These, and what misses and the published tables under ``tables`` ask for."""
        asked = self.asked.and_by_misses(self.config.combinations, self.labels, tables)
        return replace(self, asked=asked)

    def asks(self, stage: str) -> bool:
        """Whether a stage needs scores of the language model."""
        if stage == "sentence_scores":
            return self.scores is None
        return stage == "query_scores" and self.config.combinations != NONE

    @property
    def needs_model(self) -> bool:
        """Whether any score has to come from the language model."""
        return self.asks("sentence_scores") or self.asks("query_scores")

    def value(self, read: str) -> Any:
        """What a stage reads under a name: a setting, or the content of an input file."""
        match read:
            case "objects.csv":
                return self.labels.objects
            case "rooms.csv":
                return self.labels.rooms
            case "counts":
                return self.counts
            case "scores":
                return self.scores
            case "asked":
                return self.asked
            case "smoothing" if self.config.smoothing is None:
                return 1 / len(self.labels.rooms)
        return getattr(self.config, read)

    def recorded(self, read: str) -> Any:
        """The same for a record: a setting by value, an input file by hash."""
        value = self.value(read)
        if isinstance(value, PairValues | Asked):
            return value.recorded()
        if read in INPUTS and value is not None:
            rows = json.dumps([astuple(label) for label in value])
            return hashlib.sha256(rows.encode()).hexdigest()
        if isinstance(value, tuple):
            return list(value)
        return str(value) if isinstance(value, Path) else value


@dataclass(frozen=True)
class PairValues:
    """A number per (object, room) of a label space, and a hash of them all."""

    values: Mapping[Pair, float]

    def recorded(self) -> str:
        """The numbers, hashed: for the record of a build's inputs."""
        rows = json.dumps(sorted((*pair, value) for pair, value in self.values.items()))
        return hashlib.sha256(rows.encode()).hexdigest()


def read_counts(path: Path, labels: LabelSpace) -> PairValues:
    """Co-occurrence counts from a CSV (object, room, count) or from labelled room lines.

    A pair that the file lacks counts 0. A room line counts each of its objects once, under the
    room's first label.

    Raises
    ------
    InputError
        The file is malformed, or a count is negative or not a number, or a pair comes twice.
    """
    if path.suffix.casefold() in {".jsonl", ".ndjson", ".json"}:
        found: Mapping[Pair, float] = _count_rooms(path, labels)
    else:
        found = dict(_pairs(path, labels, "count", _count))
    pairs = [(o.label, r.label) for o in labels.objects for r in labels.rooms]
    return PairValues({pair: float(found.get(pair, 0.0)) for pair in pairs})


def read_scores(path: Path, labels: LabelSpace, reduction: str) -> PairValues:
    """S(o, r) in nats from a CSV: ``log_prob`` as it is, or ``mean_log_prob`` × ``token_count``.

    With reduction ``mean``, ``mean_log_prob`` is taken as it is.

    Raises
    ------
    InputError
        The file is malformed, a number is not finite, or a pair is missing or comes twice.
    """
    _, first = next(read_csv(path, ("object", "room")), ("", {}))
    if "log_prob" in first:
        values = dict(_pairs(path, labels, "log_prob", _finite))
    elif "mean_log_prob" in first and reduction == "mean":
        values = dict(_pairs(path, labels, "mean_log_prob", _finite))
    elif {"mean_log_prob", "token_count"} <= set(first):
        counts = dict(_pairs(path, labels, "token_count", _count))
        means = dict(_pairs(path, labels, "mean_log_prob", _finite))
        values = {
            pair: _finite(
                str(mean * counts[pair]), "mean_log_prob × token_count", f"{path}, {pair}"
            )
            for pair, mean in means.items()
        }
    else:
        raise InputError(
            f"{path}: missing column `log_prob`, or `mean_log_prob` with `token_count`, or no row"
        )
    for o in labels.objects:
        for r in labels.rooms:
            if (o.label, r.label) not in values:
                raise InputError(
                    f"{path}: no score for object {o.label!r} and room {r.label!r} of label space "
                    f"{labels.name}; add the row, or choose another with `--labels`"
                )
    return PairValues(values)


def _count_rooms(path: Path, labels: LabelSpace) -> Counter[Pair]:
    counts: Counter[Pair] = Counter()
    unlabelled = 0
    for room in read_room_lines(path):
        truth = labels.room_aliases.get(normalise(room.truth[0])) if room.truth else None
        if truth is None:
            unlabelled += 1
            continue
        known = {labels.object_aliases.get(normalise(name)) for name in room.objects}
        counts.update((name, truth) for name in known if name is not None)
    if unlabelled:
        log.warning("%s: %d rooms have no room label of %s", path, unlabelled, labels.name)
    return counts


def _pairs(
    path: Path, labels: LabelSpace, column: str, parse: Callable[[str, str, str], float]
) -> Iterator[tuple[Pair, float]]:
    """Pairs of the label space with the column's number; other labels are counted and passed."""
    seen: set[Pair] = set()
    unknown: set[str] = set()
    for where, row in read_csv(path, ("object", "room", column)):
        names = normalise(row["object"]), normalise(row["room"])
        found = labels.object_aliases.get(names[0]), labels.room_aliases.get(names[1])
        value = parse(row[column], column, where)
        if found[0] is None or found[1] is None:
            unknown.add(names[0] if found[0] is None else names[1])
            continue
        pair = (found[0], found[1])
        if pair in seen:
            raise InputError(f"{where}: {pair[0]!r} and {pair[1]!r} come twice; remove one row")
        seen.add(pair)
        yield pair, value
    if unknown:
        log.warning(
            "%s: %d labels are not in label space %s and are left out (%s, …)",
            path, len(unknown), labels.name, min(unknown),
        )  # fmt: skip


def _finite(text: str, column: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= FLOAT32_MAX:
        raise InputError(
            f"{where}: `{column}` must be a finite number within ±{FLOAT32_MAX:.2g}, "
            f"not {text[:40]!r}"
        )
    return value


def _count(text: str, column: str, where: str) -> float:
    value = _finite(text, column, where)
    if not 0 <= value <= LARGEST_COUNT:
        raise InputError(
            f"{where}: `{column}` must be 0 or more and at most {LARGEST_COUNT:.0f}, "
            f"not {text[:40]!r}"
        )
    return value
