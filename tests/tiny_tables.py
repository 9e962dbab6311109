"""Tables of a small label space, scored by arithmetic instead of a language model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from roomtables import build
from roomtables.scorer import SentenceScore

OBJECTS = {"bed": "", "chair": "", "fridge": "refrigerator", "lamp": "", "oven": "stove"}
ROOMS = ("bedroom", "kitchen", "office")
_FITS = {
    "bedroom": ("beds", "lamps"),
    "kitchen": ("fridges", "ovens"),
    "office": ("chairs", "lamps"),
}


class FitScorer:
    """Scores a sentence by how many of its objects fit its room, and counts its calls."""

    scorer_id = "fit-scorer"
    strategy = "padded"

    def __init__(self) -> None:
        self.calls = 0

    def describe(self) -> Mapping[str, str]:
        return {"model": "fit-scorer"}

    def score(self, sentences: Sequence[str]) -> list[SentenceScore]:
        self.calls += 1
        return [self._one(sentence) for sentence in sentences]

    def score_stream(self, sentences: Iterable[str]) -> Iterator[SentenceScore]:
        return map(self._one, sentences)

    def _one(self, sentence: str) -> SentenceScore:
        fits = sum(
            2.0 for room, things in _FITS.items() if room in sentence for thing in things
            if thing in sentence
        )  # fmt: skip
        return SentenceScore(fits - len(sentence) / 8, len(sentence.split()))


def write_labels(folder: Path) -> Path:
    """The label space's folder, named ``flat``."""
    labels = folder / "flat"
    labels.mkdir()
    objects = "".join(f"{name},{synonyms}\n" for name, synonyms in OBJECTS.items())
    (labels / "objects.csv").write_text("object,synonyms\n" + objects)
    (labels / "rooms.csv").write_text("room\n" + "".join(f"{name}\n" for name in ROOMS))
    return labels


def build_tables(folder: Path, combinations: str = "all") -> Path:
    """Published tables of the label space ``flat``; returns the tables folder."""
    build(
        tables=folder / "tables",
        scorer=FitScorer(),
        labels=str(write_labels(folder)),
        combinations=combinations,
    )
    return folder / "tables"


def change_tables(folder: Path) -> None:
    """Publish another version of what :func:`build_tables` built."""
    build(
        tables=folder / "tables",
        scorer=FitScorer(),
        labels=str(folder / "flat"),
        combinations="all",
        prior_weight=0.25,
    )
