"""Commands that label rooms: classify."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    Synonyms,
    Warnings,
    as_json,
    as_json_line,
    decision_options,
    emit,
    emit_lines,
    format_option,
    labels_option,
    labelspace_option,
    mapping_option,
    output_option,
    render,
    tables_option,
    weights_option,
)
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.online.weighing import classify_rooms
from roomtables.rooms import Room
from roomtables.scenes import read_rooms
from roomtables.scenes.matterport_labels import house_labels

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
@click.option("--explain", is_flag=True, help="Show what each object says for and against.")
@tables_option
@labels_option
@decision_options
@weights_option
@format_option()
@output_option
def classify(
    objects: tuple[str, ...],
    input_: str | None,
    labelspace: Path | None,
    category_mapping: Path | None,
    top: int | None,
    explain: bool,
    weights: str | None,
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
      roomtables classify tv sofa table --rule pooled --explain
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
    results = _classified(rooms, opened, weights)
    if format_ == "jsonl":
        emit_lines((as_json_line(_record(*result, top, explain)) for result in results), output)
        return
    records = [_record(*result, top, explain) for result in results]
    if format_ == "json":
        emit(as_json(records), output)
        return
    columns = [name for name in _COLUMNS if input_ or name != "room_id"]
    if decision.get("min_probability"):
        columns.insert(columns.index("room") + 1, "reason")
    text = render(records, format_, _with_top(records, columns) if top else columns)
    if explain and format_ == "table":
        text += "".join(_explanation(record) for record in records)
    emit(text, output)


def _with_top(records: list[dict[str, Any]], columns: list[str]) -> list[str]:
    """The columns with one of the most probable rooms, which the records are given."""
    for record in records:
        best = record["probabilities"].items()
        record["top"] = [f"{room} {probability:.3f}" for room, probability in best]
    at = columns.index("objects")
    return [*columns[:at], "top", *columns[at:]]


def _explanation(record: dict[str, Any]) -> str:
    """What each object said, the strongest for the best room first."""
    said = sorted(record["evidence"], key=lambda row: -row["difference_nats"])
    if not said:
        return ""
    versus = f" rather than {said[0]['runner_up']}" if said[0]["runner_up"] else ""
    where = f"{record['room_id']}: " if record["room_id"] else ""
    columns = (
        "object", "counted", "weight", "room_nats", "runner_up_nats", "difference_nats",
    )  # fmt: skip
    return f"\n{where}why {said[0]['room']}{versus}, in nats\n{render(said, 'table', columns)}"


def _classified(
    rooms: Iterable[Room], tables: RoomTables, weights: str | None
) -> Iterator[tuple[Room, Prediction]]:
    rooms = iter(rooms)
    while chunk := list(islice(rooms, _CHUNK)):
        predictions = classify_rooms(tables, chunk, weights)
        yield from zip(chunk, predictions, strict=True)


def _record(room: Room, prediction: Prediction, top: int | None, explain: bool) -> dict[str, Any]:
    record = prediction.as_json(room.room_id or None)
    if top:
        record["probabilities"] = dict(prediction.top(top))
    if explain:
        record["evidence"] = [said.as_json() for said in prediction.evidence]
    return record
