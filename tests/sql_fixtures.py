"""What SQL reads beside the tables, written by tests as other commands write it."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.storage.versions import Version

SAVED = datetime(2026, 1, 1)


def save_evaluation(
    version: Version, name: str, rooms: Iterable[tuple[str, str, str | None]]
) -> Path:
    """A saved evaluation, as `evaluate --save` writes it, from room ids, true rooms and answers."""
    schema = pa.schema(
        [
            ("evaluation", pa.string()), ("version", pa.string()), ("saved", pa.timestamp("us")),
            ("source", pa.string()), ("rule", pa.string()), ("room_id", pa.string()),
            ("room", pa.string()), ("predicted", pa.string()), ("probability", pa.float64()),
            ("objects", pa.list_(pa.string())), ("answered_by", pa.string()),
            ("backed_off", pa.bool_()),
        ]
    )  # fmt: skip
    rows = [
        {
            "evaluation": name, "version": version.name, "saved": SAVED, "source": "proxy",
            "rule": "query", "room_id": room_id, "room": room, "predicted": predicted,
            "probability": 0.5 if predicted else None, "objects": [],
            "answered_by": "table" if predicted else "none", "backed_off": False,
        }
        for room_id, room, predicted in rooms
    ]  # fmt: skip
    folder = version.path.parent / "evaluations"
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.parquet"
    pq.write_table(pa.Table.from_pylist(rows, schema), path)
    return path
