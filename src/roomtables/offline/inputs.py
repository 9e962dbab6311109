"""All that a build reads, validated before anything is scored or written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from roomtables.config import BuildConfig, load_labels
from roomtables.labels import LabelSpace
from roomtables.offline.combinations import check_key_size
from roomtables.offline.pairs import PairValues, read_counts, read_scores
from roomtables.offline.stages import stage_sql
from roomtables.rooms import read_room_lines
from roomtables.schemas import SCHEMA_VERSION
from roomtables.sentences import Template

# Settings that say how to build, not what; files count by their content.
_HOW = ("device", "token_budget", "engine", "full_refresh", "counts", "scores", "combinations")
_SQL_STAGES = ("single_scores", "cooccurrence", "entropy", "room_bias", "query_scores")


@dataclass(frozen=True)
class Inputs:
    """A build's settings and what their files hold.

    Attributes
    ----------
    rooms : the objects of each room whose combination is to be scored; ``None`` where the
        settings ask for all combinations or for none
    """

    config: BuildConfig
    labels: LabelSpace
    template: Template
    counts: PairValues | None
    scores: PairValues | None
    rooms: Sequence[Sequence[str]] | None

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
        )

    @property
    def smoothing(self) -> float:
        """α: what is added to each count; 1 / |R| unless set."""
        given = self.config.smoothing
        return 1 / len(self.labels.rooms) if given is None else given

    @property
    def needs_model(self) -> bool:
        """Whether any score has to come from the language model."""
        return self.scores is None or self.config.combinations != "none"

    def fingerprint(self, scorer_id: str | None) -> str:
        """A hash of everything that decides what the tables hold."""
        settings = {k: v for k, v in asdict(self.config).items() if k not in _HOW}
        parts = [
            SCHEMA_VERSION,
            self.labels.fingerprint,
            settings | {"labels": self.labels.name, "scorer_id": scorer_id},
            self.counts.fingerprint if self.counts else None,
            self.scores.fingerprint if self.scores else None,
            self.config.combinations if self.rooms is None else self.rooms,
            [stage_sql(name) for name in _SQL_STAGES],
        ]
        return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()


def _rooms(combinations: str) -> Sequence[Sequence[str]] | None:
    if combinations in {"all", "none"}:
        return None
    return sorted(
        {tuple(sorted(set(room.objects))) for room in read_room_lines(Path(combinations))}
    )
