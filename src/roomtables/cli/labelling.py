"""The command that labels rooms by their objects: classify."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    Warnings,
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
from roomtables.cli.names import NameReport
from roomtables.cli.printing import as_json, as_json_line
from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables, classify_rooms
from roomtables.online.prediction import Prediction
from roomtables.rooms import Room
from roomtables.scenes import read_rooms
from roomtables.scenes.matterport_labels import house_labels

_CHUNK = 1024  # rooms whose misses share one pass of the model
_COLUMNS = (
    "room_id", "room", "reason", "probability", "top", "objects", "unknown_objects", "rule",
    "source", "answered_by", "read_as",
)  # fmt: skip
# What a narrow terminal shows in a line beneath the table, where it is the same for all rooms.
_BENEATH = ("rule", "source", "answered_by")


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
    labels: str | None,
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
        rooms = read_rooms(
            input_,
            warn=Warnings(),
            labelspace=labelspace,
            object_labels=house_labels(opened.version.manifest.labels),
            category_mapping=category_mapping,
        )
    names = NameReport.of(opened)
    click.get_current_context().call_on_close(names.print)
    records = (
        _record(room, prediction, top, explain)
        for room, prediction in _classified(rooms, opened, weights, names)
    )
    if format_ == "jsonl":
        emit_lines(map(as_json_line, records), output)
    elif format_ == "json":
        emit(as_json(list(records)), output)
    else:
        wanted = {"room_id": input_, "top": top, "reason": decision.get("min_probability")}
        text = _as_csv if format_ == "csv" else _as_table
        emit(text(list(records), {name for name in wanted if not wanted[name]}), output)


def _as_csv(records: Sequence[dict[str, Any]], left_out: set[str]) -> str:
    columns = [name for name in _COLUMNS if name not in left_out]
    return render([_row(record) for record in records], "csv", columns)


def _as_table(records: Sequence[dict[str, Any]], left_out: set[str]) -> str:
    """A table, and below it why each room is as it is, where that was asked for.

    Why a room has no answer, and what names were read as, are columns where there is such a room.
    """
    rows = [_row(record, by_case=False) for record in records]
    for row in rows:
        row["reason"] = row.get("reason") or _why_unanswered(row)
        row["room"] = row["room"] or "–"
    if any(row["reason"] for row in rows):
        left_out = left_out - {"reason"}
    if not any(row["read_as"] for row in rows):
        left_out = left_out | {"read_as"}
    columns = [name for name in _COLUMNS if name not in left_out]
    text = render(rows, "table", columns, beneath=_BENEATH)
    return text + "".join(_explanation(record) for record in records if "evidence" in record)


def _row(record: Mapping[str, Any], by_case: bool = True) -> dict[str, Any]:
    """A record with cells of text; ``by_case``: tell of ``Chair = chair``, too."""
    top = [f"{room} {probability:.3f}" for room, probability in record["probabilities"].items()]
    pairs = record["read_as"].items()
    told = [(given, label) for given, label in pairs if by_case or normalise(given) != label]
    read_as = [f"{given} = {label}" for given, label in told]
    return {**record, "top": top, "read_as": read_as}


def _why_unanswered(row: Mapping[str, Any]) -> str | None:
    if row["room"] is not None:
        return None
    if row["objects"]:
        return "not in the tables, and no model to ask"
    return "no known object" if row["unknown_objects"] else "no object"


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
    rooms: Iterable[Room], tables: RoomTables, weights: str | None, names: NameReport
) -> Iterator[tuple[Room, Prediction]]:
    rooms = iter(rooms)
    while chunk := list(islice(rooms, _CHUNK)):
        predictions = classify_rooms(tables, chunk, weights)
        for room, prediction in zip(chunk, predictions, strict=True):
            names.take(prediction)
            yield room, prediction


def _record(room: Room, prediction: Prediction, top: int | None, explain: bool) -> dict[str, Any]:
    record = prediction.as_json(room.room_id or None)
    if top:
        record["probabilities"] = dict(prediction.top(top))
    if explain:
        record["evidence"] = [said.as_json() for said in prediction.evidence]
    return record
