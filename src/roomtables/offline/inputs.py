"""All that a build reads, validated before anything is scored or written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from roomtables.config import BuildConfig, load_labels
from roomtables.labels import LabelSpace
from roomtables.offline.asked import Asked
from roomtables.offline.combinations import check_key_size
from roomtables.offline.pairs import PairValues, read_counts, read_scores
from roomtables.rooms import read_room_lines
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
