"""Commands that label rooms: classify, and serve for a running robot's."""

from __future__ import annotations

import gc
import logging
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    Namer,
    Synonyms,
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
from roomtables.cli.printing import as_json, as_json_line, echo
from roomtables.online.classifier import RoomTables, classify_rooms
from roomtables.online.prediction import Prediction
from roomtables.online.serve import Labeller, Service
from roomtables.rooms import Room
from roomtables.scenes import read_rooms
from roomtables.scenes.matterport_labels import house_labels
from roomtables.scenes.sparkdsg import GraphCodec, LiveGraph

_CHUNK = 1024  # rooms whose misses share one pass of the model
_COLUMNS = (
    "room_id", "room", "reason", "probability", "top", "objects", "unknown_objects", "rule",
    "source", "answered_by",
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
        rooms = _rooms_of(
            input_,
            opened,
            labelspace=labelspace,
            object_labels=house_labels(labels),
            category_mapping=category_mapping,
        )
    records = (
        _record(room, prediction, top, explain)
        for room, prediction in _classified(rooms, opened, weights)
    )
    if format_ == "jsonl":
        emit_lines(map(as_json_line, records), output)
    elif format_ == "json":
        emit(as_json(list(records)), output)
    else:
        left_out = set() if input_ else {"room_id"}
        left_out |= set() if top else {"top"}
        left_out |= set() if decision.get("min_probability") else {"reason"}
        columns = [name for name in _COLUMNS if name not in left_out]
        emit(_as_text(list(records), format_, columns), output)


def _rooms_of(path: str, tables: RoomTables, **reading: Any) -> Iterator[Room]:
    """The rooms of a file; which names were read as synonyms is said at the end."""
    synonyms = Synonyms(tables)
    click.get_current_context().call_on_close(synonyms.report)
    return synonyms.watch(read_rooms(path, warn=Warnings(), **reading))


def _as_text(records: Sequence[dict[str, Any]], format_: str, columns: Sequence[str]) -> str:
    """A table or CSV; below a table, why each room is as it is, where that was asked for."""
    rows = [record | {"top": _shown(record["probabilities"])} for record in records]
    text = render(rows, format_, columns)
    if format_ == "table":
        text += "".join(_explanation(record) for record in records if "evidence" in record)
    return text


def _shown(probabilities: Mapping[str, float]) -> list[str]:
    return [f"{room} {probability:.3f}" for room, probability in probabilities.items()]


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


@click.command()
@click.option(
    "--recv",
    default="tcp://127.0.0.1:8001",
    show_default=True,
    help="Where graphs come from: Hydra's ZmqSink.",
)
@click.option(
    "--send",
    default="tcp://127.0.0.1:8002",
    show_default=True,
    help="Where labelled graphs are published: Hydra's ZmqRoomLabelUpdater listens there.",
)
@click.option(
    "--report-every",
    type=click.FloatRange(min=0.1),
    default=10.0,
    show_default=True,
    help="Seconds between two lines of counters on stderr.",
)
@tables_option
@labels_option
@labelspace_option
@decision_options
def serve(
    recv: str,
    send: str,
    report_every: float,
    tables: Path,
    labels: str,
    labelspace: Path | None,
    offline: bool,
    **decision: Any,
) -> None:
    """Label a running Hydra's rooms as they change, until interrupted.

    What no table holds is answered by pooled evidence at once, and by the language model a little
    later, unless --offline forbids it.

    \b
    Example:
      roomtables serve --labelspace ade20k_mp3d_label_space.yaml
    """
    logging.addLevelName(logging.INFO, "info")
    logging.getLogger("roomtables").setLevel(logging.INFO)
    opened = RoomTables.open(tables, labels, offline=True, **decision)
    asking = None if offline else RoomTables.open(tables, labels, **decision)
    candidates, namer = [room.label for room in opened.candidates], Namer(opened)

    def name(graph: LiveGraph, answers: Mapping[str, Prediction]) -> None:
        graph.name_rooms(namer(answers), candidates)

    service = Service(GraphCodec(labelspace), Labeller(opened, asking), name, recv, send)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    echo(f"labelling rooms of {recv}, publishing on {send}; Ctrl-C ends it", err=True)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; to look it over again would hold graphs up
    try:
        service.run(stop, report_every)
    finally:
        service.close()
        gc.unfreeze()
    echo(f"stopped: {service.counters.line()}", err=True)
