"""Answers as names for a scene graph's rooms: shared by label and serve."""

from __future__ import annotations

from collections.abc import Mapping

from roomtables import __version__
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.scenes.dsg_labels import NamedRoom


def named_rooms(answers: Mapping[str, Prediction], tables: RoomTables) -> dict[str, NamedRoom]:
    """A name for each answered room, with what a reader of the graph needs to judge it."""
    manifest = tables.version.manifest
    shared = {
        "model": manifest["query_scorer_id"] or manifest["scorer_id"],
        "labels": manifest["labels"],
        "version": tables.version.name,
        "roomtables": __version__,
    }
    return {
        key: NamedRoom(answer.room, answer.probabilities, _provenance(answer) | shared)
        for key, answer in answers.items()
        if answer.room is not None
    }


def _provenance(answer: Prediction) -> dict[str, object]:
    return {
        "label": answer.room,
        "probability": answer.probability,
        "objects": list(answer.objects),
        "rule": answer.rule,
        "source": answer.source,
        "answered_by": answer.answered_by,
    }
