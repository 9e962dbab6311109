"""The manifest of a version: what the version is, how it was made, and the hash of each file.

One frozen record with one reader and one writer. Its own hash stands in ``CURRENT``, so that
nothing in it can change unnoticed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from datetime import datetime, timezone
from functools import cache
from math import comb, inf
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from roomtables.config import BuildConfig
from roomtables.errors import ConfigError, first_line
from roomtables.limits import MalformedError, json_value
from roomtables.schemas import SCHEMA_VERSION
from roomtables.storage.files import sha256_of

# Years that every time zone's arithmetic can hold.
_YEARS = range(1970, 9000)
_LONGEST_NAME = 255  # of a file, in bytes
# Settings that manifests of this schema version may lack, being older: their default is meant.
_ADDED = {"scored"}


def count_combinations(objects: int, k: int) -> int:
    """How many combinations of 1 to ``k`` objects there are (7,175 for 35 objects and k = 3)."""
    return sum(comb(objects, size) for size in range(1, k + 1))


class ManifestError(ValueError):
    """The content is no manifest: what is wrong with it, without saying where it lies."""


class SchemaVersionError(ManifestError):
    """A manifest of tables that another roomtables wrote."""

    def __init__(self, found: object) -> None:
        super().__init__(
            f"it has schema version {str(found)[:20]}, this roomtables reads {SCHEMA_VERSION}"
        )


@dataclass(frozen=True)
class FileFacts:
    """Size and SHA-256 of a published file."""

    bytes: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> FileFacts:
        """The facts of a file as it is now."""
        with path.open("rb") as file:
            digest = sha256_of(file)
        return cls(path.stat().st_size, digest)


@dataclass(frozen=True)
class Rate:
    """What scoring cost in the build that measured it: for `plan` to go by."""

    sentences_per_second: float
    tokens_per_sentence: float
    sentences: int
    workers: int


@dataclass(frozen=True)
class Coverage:
    """How many of the possible combinations are held, and what scoring the rest would take.

    ``rest_seconds`` is ``None`` where no build of this model has been timed.
    """

    combinations: int
    held: int
    rest_sentences: int
    rest_seconds: float | None

    @classmethod
    def of(cls, possible: int, held: int, rooms: int, rate: Rate | None) -> Coverage:
        """Of so many combinations some are held; the others have a sentence per predicted room."""
        sentences = (possible - held) * rooms
        speed = rate.sentences_per_second if rate else 0.0
        seconds = round(sentences / speed, 1) if speed else None
        return cls(possible, held, sentences, seconds)


@dataclass(frozen=True)
class Manifest:
    """What a version says of itself.

    Attributes
    ----------
    labels : the label space's name
    created : when it was published, in UTC
    seconds : what the build took
    settings : every setting of the build, by value
    stages : per stage, what it read: a setting by value, an input file or an earlier stage by hash
    scorer_id : whose single-object scores the co-occurrence tables hold
    query_scorer_id : who scored the query sentences; ``None`` where no model was asked
    model : provenance of that scorer (versions, device, strategy); empty where none was asked
    score_parts : names of the part files that held its sentences
    rate : what scoring cost, last time; ``None`` where nothing was scored yet
    objects, rooms, predicted_rooms : how many labels there are
    rows : rows per table
    combinations : rows of the query scores per source
    sentences, sentences_scored : how many the build needed, and how many it had to score
    files : size and hash of each file of the version, by path inside it
    """

    labels: str
    created: datetime
    seconds: float
    settings: BuildConfig
    stages: Mapping[str, Mapping[str, Any]]
    scorer_id: str
    query_scorer_id: str | None
    model: Mapping[str, str]
    score_parts: tuple[str, ...]
    rate: Rate | None
    objects: int
    rooms: int
    predicted_rooms: int
    rows: Mapping[str, int]
    combinations: Mapping[str, int]
    sentences: int
    sentences_scored: int
    files: Mapping[str, FileFacts]
    schema_version: int = field(default=SCHEMA_VERSION)

    @property
    def extends_tables(self) -> bool:
        """Whether the model that scores query sentences gave the single-object scores, too."""
        return self.scorer_id == self.query_scorer_id

    @property
    def coverage(self) -> Coverage:
        """Of all combinations of up to k objects, over all sources, those that the tables hold."""
        possible = len(self.combinations) * count_combinations(self.objects, self.settings.k)
        held = sum(self.combinations.values())
        return Coverage.of(possible, held, self.predicted_rooms, self.rate)

    def to_bytes(self) -> bytes:
        """The content of ``manifest.json``."""
        content = asdict(self) | {
            "created": self.created.isoformat(timespec="seconds"),
            "settings": self.settings.recorded(),
        }
        return json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False).encode()

    @classmethod
    def from_bytes(cls, content: bytes) -> Manifest:
        """A manifest from the content of ``manifest.json``.

        Raises
        ------
        ManifestError
            It is not JSON, lacks a key, holds another or a value of another type, or is of another
            schema version.
        """
        try:
            value = json_value(content)
        except MalformedError as error:
            raise ManifestError(first_line(error)) from error
        if not isinstance(value, dict):
            raise ManifestError("it is not a JSON object")
        if value.get("schema_version") != SCHEMA_VERSION:
            raise SchemaVersionError(value.get("schema_version"))
        manifest: Manifest = _record(cls, value, "")
        for name in manifest.files:
            _check_file_name(name)
        return manifest


def _check_file_name(name: str) -> None:
    """Refuse what cannot be a path inside a version: ``..``, control characters, too long."""
    parts = name.split("/")
    whole = all(part not in {"", ".", ".."} for part in parts) and name.isprintable()
    if not whole or max(len(part.encode()) for part in parts) > _LONGEST_NAME or len(parts) > 8:
        raise ManifestError(f"`files` names {name[:40]!r}, which is no file of a version")


@cache
def _types(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


def _record(record: Any, value: Any, where: str) -> Any:
    """A dataclass from a JSON object that holds exactly its fields."""
    if not isinstance(value, dict):
        raise ManifestError(f"`{where}` is not a JSON object")
    types = _types(record)
    for key in types.keys() ^ value.keys():
        wrong = "it lacks" if key in types else "it holds the unknown key"
        raise ManifestError(f"{wrong} `{where}{key}`"[:200])
    return record(**{key: _value(types[key], value[key], f"{where}{key}") for key in types})


def _value(kind: Any, value: Any, where: str) -> Any:
    """A JSON value as the type of a field says."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is UnionType:  # a type, or None
        return None if value is None else _value(_without_none(inside), value, where)
    if origin is tuple and isinstance(value, list):
        return tuple(_value(inside[0], item, where) for item in value)
    if origin is Mapping and isinstance(value, dict):
        return {key: _value(inside[1], item, f"{where}.{key}") for key, item in value.items()}
    if kind is Any:
        return value
    if kind is datetime and isinstance(value, str):
        return _moment(value, where)
    if kind is BuildConfig and isinstance(value, dict):
        return _settings(value)
    if is_dataclass(kind):
        return _record(kind, value, f"{where}.")
    if kind in {int, float} and type(value) in {int, kind}:
        return _count(value, where)
    if kind is str and isinstance(value, str):
        return value
    raise ManifestError(f"`{where}` is of the wrong type"[:200])


def _without_none(kinds: tuple[Any, ...]) -> Any:
    (kind,) = (kind for kind in kinds if kind is not NoneType)
    return kind


def _count(value: float, where: str) -> float:
    if not 0 <= value < inf:
        raise ManifestError(f"`{where}` must be 0 or more, not {value}"[:200])
    return value


def _moment(text: str, where: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = datetime.min
    if moment.tzinfo is None or moment.year not in _YEARS:
        raise ManifestError(f"`{where}` is no time with a time zone, or of no year of ours")
    return moment.astimezone(timezone.utc)


def _settings(value: dict[str, Any]) -> BuildConfig:
    missing = BuildConfig.recorded_names() - value.keys() - _ADDED
    if missing:
        raise ManifestError(f"it lacks `settings.{min(missing)}`")
    try:
        return BuildConfig.of(value, "settings")
    except ConfigError as error:
        raise ManifestError(first_line(error)) from error
