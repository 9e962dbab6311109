"""Helpers that several tests share."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import repeat
from pathlib import Path

from roomtables.config import BuildConfig
from roomtables.labels import LabelSpace, RoomLabel
from roomtables.scorer import SentenceScore
from roomtables.storage.files import utc_now
from roomtables.storage.manifest import FileFacts, Manifest


class HashScorer:
    """A deterministic scorer without a model: a sentence's hash is its score. Counts its calls."""

    strategy = "hash"

    def __init__(self, name: str = "hash@1") -> None:
        self.scorer_id = name
        self.asked: list[str] = []

    def describe(self) -> Mapping[str, str]:
        return {"model": self.scorer_id, "strategy": self.strategy}

    def score(
        self, sentences: Sequence[str], starts: Sequence[int] | None = None
    ) -> list[SentenceScore]:
        return list(self.score_stream(sentences, starts))

    def score_stream(
        self, sentences: Iterable[str], starts: Iterable[int] | None = None
    ) -> Iterator[SentenceScore]:
        from_character = repeat(0) if starts is None else starts
        for sentence, start in zip(sentences, from_character, strict=False):
            self.asked.append(sentence)
            yield self.score_of(f"{sentence} from {start}" if start else sentence)

    def score_of(self, sentence: str) -> SentenceScore:
        digest = hashlib.sha256(f"{self.scorer_id} {sentence}".encode()).digest()
        nats = int.from_bytes(digest[:4], "big") / 2**32 * 8
        return SentenceScore(-20.0 - nats, len(sentence.split()))


def small_space(name: str = "small") -> LabelSpace:
    """Four objects and four rooms, one of them never predicted."""
    space = LabelSpace.named(
        name, ["bed", "sink", "stove", "toilet"], ["bathroom", "bedroom", "kitchen"]
    )
    return LabelSpace(
        name, space.objects, (*space.rooms, RoomLabel("yard", "a", (), predicted=False))
    )


def write_space(folder: Path, space: LabelSpace) -> Path:
    """The label space's files in ``folder/<name>``."""
    target = folder / space.name
    target.mkdir(parents=True, exist_ok=True)
    for name, text in space.csv_files().items():
        (target / name).write_text(text, encoding="utf-8")
    return target


def made_manifest(folder: Path, **changes: object) -> Manifest:
    """A manifest of the files in a folder, as of a build that did nothing else."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    values: dict[str, object] = {
        "labels": "home", "created": utc_now(), "seconds": 0.0, "settings": BuildConfig(),
        "stages": {}, "scorer_id": "hash@1", "query_scorer_id": "hash@1", "model": {},
        "score_parts": (), "rate": None, "objects": 4, "rooms": 4, "predicted_rooms": 3,
        "rows": {}, "combinations": {"proxy": 0}, "sentences": 0, "sentences_scored": 0,
        "files": {path.relative_to(folder).as_posix(): FileFacts.of(path) for path in files},
    }  # fmt: skip
    return Manifest(**values | changes)  # type: ignore[arg-type]
