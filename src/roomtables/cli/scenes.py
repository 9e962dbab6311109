"""Commands about scenes: rooms, label, show."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
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
)
from roomtables.cli.completion import complete_labels
from roomtables.cli.names import NameReport
from roomtables.cli.naming import Namer, keep_names_option
from roomtables.cli.printing import as_json_line, echo, safe_json
from roomtables.cli.progress import counted
from roomtables.config import BuildConfig, load_labels
from roomtables.errors import InputError, StoreError
from roomtables.names import NameReader
from roomtables.online.classifier import RoomTables
from roomtables.scenes.dsg import graph_scene, label_rooms
from roomtables.scenes.matterport_labels import house_labels
from roomtables.scenes.reader import read_graph, read_scene, scene_files
from roomtables.scenes.room_lists import read_true_rooms, with_true_rooms, write_nested
from roomtables.scenes.scene import ReadOptions, Scene, SceneRoom, room_frequencies
from roomtables.scenes.sparkdsg import write_sparkdsg
from roomtables.storage.files import write_aside

scene_argument = click.argument("scene", type=click.Path(path_type=Path))
graph_output_option = click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False)
)


@click.command()
@click.argument(
    "scenes", metavar="SCENE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--all", "keep_all", is_flag=True, help="Keep .house rooms that the paper drops.")
@click.option(
    "--labels",
    default="mpcat40",
    show_default=True,
    shell_complete=complete_labels,
    help="Object labels of .house files.",
)
@labelspace_option
@mapping_option
@click.option(
    "--room-list",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A CSV (room_id,room) of true rooms, for formats that do not name them.",
)
@click.option("--frequencies", is_flag=True, help="Count the true room labels (paper, table 1).")
@format_option("jsonl", "nested", "table", "json", "csv", default="jsonl")
@output_option
def rooms(
    scenes: tuple[Path, ...],
    keep_all: bool,
    labels: str,
    labelspace: Path | None,
    category_mapping: Path | None,
    room_list: Path | None,
    frequencies: bool,
    format_: str,
    output: Path | None,
) -> None:
    """Turn SCENEs of any supported format into room lines; the content decides the format.

    A folder stands for the .house files in it, or for an HOV-SG graph. Names that the default label
    space does not know are told on stderr.

    \b
    Example:
      roomtables rooms dsg.json --labelspace ade20k_mp3d_label_space.yaml
      roomtables rooms v1/scans --frequencies --format csv
    """
    options = ReadOptions(labelspace, keep_all, labels, category_mapping, Warnings())
    found = _scenes(scenes, options)
    if room_list is not None:
        true_rooms = read_true_rooms(room_list)
        found = (with_true_rooms(scene, true_rooms) for scene in found)
    space = load_labels(BuildConfig().labels)
    names = NameReport(NameReader(space.object_names), space.name)
    click.get_current_context().call_on_close(names.print_unknown)
    found = names.watch(found)
    if frequencies:
        _emit_frequencies(found, "table" if format_ in ("jsonl", "nested") else format_, output)
    elif format_ == "nested":
        emit_lines(map(safe_json, write_nested(found)), output)
    else:
        lines = (room.as_room().as_json() for scene in found for room in scene.rooms)
        if format_ == "jsonl":
            emit_lines(map(as_json_line, lines), output)
        else:
            emit(render(list(lines), format_, ("room_id", "room", "objects")), output)


def _scenes(paths: Iterable[Path], options: ReadOptions) -> Iterator[Scene]:
    """The scenes of all paths, one at a time; ids that several scenes could share get a prefix."""
    files = [file for path in paths for file in scene_files(path)]
    for file in counted(files, "scenes"):
        scene = read_scene(file, options)
        if len(files) > 1 and scene.local_ids:
            name = scene.name
            prefixed = [replace(room, room_id=f"{name}/{room.room_id}") for room in scene.rooms]
            scene = replace(scene, rooms=prefixed)
        yield scene


def _emit_frequencies(scenes: Iterable[Scene], format_: str, output: Path | None) -> None:
    count = sum((room_frequencies(scene.rooms) for scene in scenes), Counter[str]())
    total = sum(count.values())
    rows: list[dict[str, Any]] = [
        {"room": room, "occurrences": number, "percentage": round(100 * number / total, 2)}
        for room, number in sorted(count.items())
    ]
    if format_ == "table":
        rows.append({"room": "total", "occurrences": total, "percentage": 100.0 if total else 0.0})
    emit(render(rows, format_, ("room", "occurrences", "percentage")), output)


@click.command()
@scene_argument
@graph_output_option
@tables_option
@labels_option
@labelspace_option
@keep_names_option
@decision_options
def label(
    scene: Path,
    output: Path,
    tables: Path,
    labels: str | None,
    labelspace: Path | None,
    keep_names: bool,
    **decision: Any,
) -> None:
    """Name the rooms of a scene graph; nothing else in the graph changes.

    A room without an answer gets back the name that its id stands for, if the one it bears is from
    roomtables.

    \b
    Example:
      roomtables label dsg.json -o labelled.json
    """
    options = ReadOptions(labelspace, warn=Warnings())
    graph = read_graph(scene)
    found = list(graph_scene(graph, scene.stem, options).rooms)
    opened = RoomTables.open(tables, labels, **decision)
    answers = opened.classify_many([room.as_room().objects for room in found])
    names = NameReport.of(opened)
    for answer in answers:
        names.take(answer)
    by_room = {room.room_id: answer for room, answer in zip(found, answers, strict=True)}
    named = Namer(opened)(by_room)
    candidates = [room.label for room in opened.candidates]
    count = label_rooms(graph, named, candidates, keep_names=keep_names)
    if output.suffix == ".sparkdsg":
        write_sparkdsg(graph.document, output)
    else:
        write_aside(output, json.dumps(graph.document, separators=(",", ":")).encode())
    names.print()
    echo(f"{output}: {count} of {len(found)} rooms named", err=True)


@click.command()
@scene_argument
@graph_output_option
@tables_option
@labels_option
@labelspace_option
@mapping_option
@click.option("--all", "keep_all", is_flag=True, help="Keep .house rooms that the paper drops.")
@decision_options
def show(
    scene: Path,
    output: Path,
    tables: Path,
    labels: str | None,
    labelspace: Path | None,
    category_mapping: Path | None,
    keep_all: bool,
    **decision: Any,
) -> None:
    """Draw a scene's rooms as a floor plan (.html, .png or .svg), right and wrong in colour.

    \b
    Example:
      roomtables show dsg.json -o scene.html
    """
    from roomtables.report.floor_plan import draw, needs_matplotlib

    needs_matplotlib(output)
    warn = Warnings()
    options = ReadOptions(labelspace, keep_all, house_labels(labels), category_mapping, warn)
    read = read_scene(scene, options)
    found = list(read.rooms)
    try:
        opened = RoomTables.open(tables, labels, **decision)
    except StoreError as error:
        warn(f"drawn without answers: {error}")
        answers = {}
    else:
        objects = [room.as_room().objects for room in found]
        answers = _answers(found, opened.classify_many(objects))
    if not found:
        raise InputError(f"{scene} holds no room to draw; give `--all`, or another scene")
    drawn = draw(replace(read, rooms=found), answers, output)
    rest = len(found) - drawn
    left_out = f"; {rest} without a place" if rest else ""
    echo(f"{output}: {drawn} rooms drawn{left_out}", err=True)


def _answers(rooms: list[SceneRoom], predictions: Sequence[Any]) -> dict[str, tuple[str, float]]:
    """Each answered room's label and its probability."""
    pairs = zip(rooms, predictions, strict=True)
    return {room.room_id: (p.room, p.probability) for room, p in pairs if p.room is not None}
