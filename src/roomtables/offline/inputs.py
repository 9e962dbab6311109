"""All that a build reads, validated before anything is scored or written."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.config import BuildConfig, load_labels
from roomtables.csv_rows import read_csv
from roomtables.errors import InputError
from roomtables.labels import LabelSpace, normalise
from roomtables.offline.combinations import Asked, check_key_size
from roomtables.rooms import read_room_lines
from roomtables.scorer import Scorer
from roomtables.sentences import Template


@dataclass(frozen=True)
class Inputs:
    """A build's settings and what their files hold.

    Attributes
    ----------
    rooms : the objects of each room whose combination is to be scored; ``None`` where the
        settings ask for no file's rooms
    asked : combinations that misses, or what is published, ask for besides
    """

    config: BuildConfig
    labels: LabelSpace
    template: Template
    counts: PairValues | None
    scores: PairValues | None
    rooms: Sequence[Sequence[str]] | None
    asked: Asked

    @classmethod
    def read(cls, config: BuildConfig) -> Inputs:
        """Read and validate.

        Raises
        ------
        RoomtablesError
            A file is missing or malformed, or a setting makes no sense.
        """
        labels = load_labels(config.labels)
        check_key_size(len(labels.objects), config.k)
        return cls(
            config,
            labels,
            Template(config.template),
            read_counts(config.counts, labels) if config.counts else None,
            read_scores(config.scores, labels, config.reduction) if config.scores else None,
            _rooms(config.combinations),
            Asked({}),
        )

    def asking(self, tables: Path) -> Inputs:
        """These, and what the misses and the published version under ``tables`` ask for."""
        return replace(self, asked=Asked.read(self.config.combinations, self.labels, tables))

    @property
    def smoothing(self) -> float:
        """α: what is added to each count; 1 / |R| unless set."""
        given = self.config.smoothing
        return 1 / len(self.labels.rooms) if given is None else given

    @property
    def needs_model(self) -> bool:
        """Whether any score has to come from the language model."""
        return self.scores is None or self.config.combinations != "none"


def _rooms(combinations: str) -> Sequence[Sequence[str]] | None:
    if combinations in {"all", "none", "misses"}:
        return None
    return sorted(
        {tuple(sorted(set(room.objects))) for room in read_room_lines(Path(combinations))}
    )


log = logging.getLogger(__name__)

Pair = tuple[str, str]


@dataclass(frozen=True)
class PairValues:
    """A number per (object, room) of a label space, and a hash of them all."""

    values: Mapping[Pair, float]

    @property
    def fingerprint(self) -> str:
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
        values = {pair: mean * counts[pair] for pair, mean in means.items()}
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
    if not math.isfinite(value):
        raise InputError(f"{where}: `{column}` must be a finite number, not {text!r}")
    return value


def _count(text: str, column: str, where: str) -> float:
    value = _finite(text, column, where)
    if value < 0:
        raise InputError(f"{where}: `{column}` must be 0 or more, not {text!r}")
    return value


class LazyScorer:
    """A scorer that costs nothing until a sentence is missing from the cache."""

    def __init__(self, config: BuildConfig, given: Scorer | None = None) -> None:
        self._config = config
        self._scorer = given
        self._scorer_id = given.scorer_id if given else None

    @property
    def scorer_id(self) -> str:
        """The identity, from the files of the model alone."""
        if self._scorer_id is None:
            from roomtables.lm import identify

            self._scorer_id = identify(self._config.model, **self._settings())
        return self._scorer_id

    def load(self, progress: bool = False) -> Scorer:
        """The scorer itself; with ``progress`` one loaded here shows its own progress bar.

        Raises
        ------
        ModelError, MissingExtraError
            The model cannot be loaded, or torch is not installed.
        """
        if self._scorer is None:
            from roomtables.lm import load_scorer

            self._scorer = load_scorer(
                self._config.model,
                token_budget=self._config.token_budget,
                progress=progress,
                **self._settings(),
            )
        return self._scorer

    def describe(self) -> Mapping[str, str]:
        """Provenance, where the model was loaded at all."""
        return dict(self._scorer.describe()) if self._scorer else {}

    def _settings(self) -> dict[str, Any]:
        names = ("revision", "dtype", "device", "scoring")
        return {name: getattr(self._config, name) for name in names}
