"""Evaluations kept beside the tables, so that SQL can ask about single rooms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from roomtables.evaluation.judging import Evaluation
from roomtables.online.classifier import RoomTables
from roomtables.storage.client_databases import write_anew
from roomtables.storage.evaluations import save_evaluation
from roomtables.storage.files import utc_now


def save(evaluations: Sequence[Evaluation], tables: RoomTables, name: str) -> tuple[Path, bool]:
    """Keep what was predicted, in one file; its path, and whether it took another's place.

    The databases that were asked for of the tables are written anew, so that they show it.

    One row per evaluation and room; table ``evaluations`` of the data dictionary says of what.

    Raises
    ------
    InputError
        The name is no plain file name.
    StoreError
        The file cannot be written.
    """
    saved = utc_now().replace(tzinfo=None)
    version = tables.version
    rows = (row for found in evaluations for row in _rows(found, name, version.name, saved))
    space = version.path.parent
    written = save_evaluation(space, name, rows)
    write_anew(space.parent)
    return written


def _rows(found: Evaluation, name: str, version: str, saved: datetime) -> Iterator[dict[str, Any]]:
    for judged in found.judged:
        answer = judged.prediction
        yield {
            "evaluation": name,
            "version": version,
            "saved": saved,
            "source": found.source,
            "rule": found.rule,
            "room_id": judged.room.room_id,
            "room": judged.truth[0],
            "predicted": answer.room,
            "probability": None if answer.room is None else answer.probability,
            "objects": list(answer.objects),
            "answered_by": answer.answered_by,
            "backed_off": answer.backed_off,
        }
