"""Answers as names for a scene graph's rooms: shared by label and serve."""

from __future__ import annotations

from collections.abc import Mapping

from roomtables import __version__
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.scenes.dsg_labels import NamedRoom

_MOST_NAMES = 65_536


class Namer:
    """Makes names of answers; an answer that was named before costs a dictionary lookup."""

    def __init__(self, tables: RoomTables) -> None:
        manifest = tables.version.manifest
        self._shared = {
            "model": manifest["query_scorer_id"] or manifest["scorer_id"],
            "labels": manifest["labels"],
            "version": tables.version.name,
            "roomtables": __version__,
        }
        # By identity; each entry holds its answer, so that no other can take its id.
        self._named: dict[int, tuple[Prediction, NamedRoom]] = {}

    def __call__(self, answers: Mapping[str, Prediction]) -> dict[str, NamedRoom]:
        """A name for each answered room, with what a reader of the graph needs to judge it."""
        if len(self._named) > _MOST_NAMES:
            self._named.clear()
        return {key: self._known(answer) for key, answer in answers.items() if answer.room}

    def _known(self, answer: Prediction) -> NamedRoom:
        known = self._named.get(id(answer))
        if known is None:
            known = self._named[id(answer)] = answer, self._name(answer)
        return known[1]

    def _name(self, answer: Prediction) -> NamedRoom:
        assert answer.room is not None
        return NamedRoom(answer.room, answer.probabilities, _provenance(answer) | self._shared)


def _provenance(answer: Prediction) -> dict[str, object]:
    return {
        "label": answer.room,
        "probability": answer.probability,
        "objects": list(answer.objects),
        "rule": answer.rule,
        "source": answer.source,
        "answered_by": answer.answered_by,
    }
