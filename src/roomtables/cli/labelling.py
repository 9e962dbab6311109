"""Commands that label rooms: classify."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    as_json,
    as_json_line,
    decision_options,
    emit,
    emit_lines,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.scenes import Warnings, house_labels, labelspace_option, mapping_option
from roomtables.cli.synonyms import Synonyms
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.rooms import Room
from roomtables.scenes import read_rooms

_CHUNK = 1024  # rooms whose misses share one pass of the model
_COLUMNS = (
    "room_id", "room", "probability", "objects", "unknown_objects", "rule", "source", "answered_by",
)  # fmt: skip


@click.command()
@click.argument("objects", nargs=-1)
@click.option("--input", "input_", help="A scene or room list; `-` reads JSON lines from stdin.")
@labelspace_option
@mapping_option
@click.option("--top", type=click.IntRange(min=1), help="Show the N most probable rooms.")
@tables_option
@labels_option
@decision_options
@format_option()
@output_option
def classify(
    objects: tuple[str, ...],
    input_: str | None,
    labelspace: Path | None,
    category_mapping: Path | None,
    top: int | None,
    tables: Path,
    labels: str,
    format_: str,
    output: Path | None,
    **decision: Any,
) -> None:
    """Label a room by its OBJECTs, or every room of a file, in order.

    \b
    Example:
      roomtables classify toilet sink towel
      roomtables classify --input rooms.jsonl --format jsonl --offline
    """
    if bool(objects) == bool(input_):
        raise click.UsageError("give either OBJECTs or --input FILE")
    opened = RoomTables.open(tables, labels, **decision)
    rooms: Iterable[Room] = [Room("", objects)]
    if input_:
        synonyms = Synonyms(opened)
        click.get_current_context().call_on_close(synonyms.report)
        found = read_rooms(
            input_,
            labelspace=labelspace,
            object_labels=house_labels(labels),
            category_mapping=category_mapping,
            warn=Warnings(),
        )
        rooms = synonyms.watch(found)
    results = _classified(rooms, opened)
    if format_ == "jsonl":
        emit_lines((as_json_line(_record(*result, top)) for result in results), output)
        return
    records = [_record(*result, top) for result in results]
    if format_ == "json":
        emit(as_json(records), output)
        return
    columns = [name for name in _COLUMNS if input_ or name != "room_id"]
    if top:
        columns.insert(columns.index("objects"), "top")
        for record in records:
            best = record["probabilities"].items()
            record["top"] = [f"{room} {probability:.3f}" for room, probability in best]
    emit(render(records, format_, columns), output)


def _classified(rooms: Iterable[Room], tables: RoomTables) -> Iterator[tuple[Room, Prediction]]:
    rooms = iter(rooms)
    while chunk := list(islice(rooms, _CHUNK)):
        predictions = tables.classify_many([room.objects for room in chunk])
        yield from zip(chunk, predictions, strict=True)


def _record(room: Room, prediction: Prediction, top: int | None) -> dict[str, Any]:
    record = prediction.as_json(room.room_id or None)
    if top:
        record["probabilities"] = dict(prediction.top(top))
    return record
