"""Commands about label spaces: list, show, import, from-rooms, check."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import click

from roomtables.cli.common import (
    Warnings,
    emit,
    format_option,
    labels_option,
    labelspace_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.completion import complete_labels
from roomtables.cli.printing import echo
from roomtables.config import DEFAULT_LABELS, builtin_labels, labels_name, load_labels
from roomtables.errors import InputError
from roomtables.labels import LabelSpace, Name
from roomtables.names import NameReader
from roomtables.online.classifier import RoomTables
from roomtables.online.name_check import check_names, summary
from roomtables.rooms import read_room_lines
from roomtables.scenes import read_rooms
from roomtables.scenes.hydra import read_hydra_labels, to_label_space
from roomtables.storage.files import write_aside
from roomtables.storage.spaces import find_labels, published_labels

# What ends so is a file, whether or not it is there.
_SUFFIXES = frozenset(
    [".csv", ".house", ".json", ".jsonl", ".ndjson", ".sparkdsg", ".txt", ".yaml", ".yml"]
)
_YAML = frozenset([".yaml", ".yml"])


@click.group()
def labels() -> None:
    """Label spaces: the names of objects and rooms.

    \b
    Example:
      roomtables labels show household
    """


@labels.command("list")
@format_option()
@output_option
def list_command(format_: str, output: Path | None) -> None:
    """List the built-in label spaces.

    \b
    Example:
      roomtables labels list
    """
    spaces = [load_labels(name) for name in builtin_labels()]
    rows = [
        {
            "labels": space.name,
            "objects": len(space.objects),
            "rooms": len(space.rooms),
            "predicted_rooms": len(space.predicted_rooms),
        }
        for space in spaces
    ]
    emit(render(rows, format_), output)


@labels.command()
@click.argument("space", metavar="NAME|DIR", shell_complete=complete_labels)
@tables_option
@format_option()
@output_option
def show(space: str, tables: Path, format_: str, output: Path | None) -> None:
    """Show a label space: labels, how sentences say them, synonyms.

    \b
    Example:
      roomtables labels show nyuclass --format csv
    """
    found = find_labels(space, tables)
    columns = ("kind", "label", "in_a_sentence", "synonyms", "predicted")
    listed: list[tuple[object, ...]] = [
        *(("object", o.label, o.plural, list(o.synonyms), None) for o in found.objects),
        *(("room", r.label, r.phrase, list(r.synonyms), r.predicted) for r in found.rooms),
    ]
    rows = [dict(zip(columns, row, strict=True)) for row in listed]
    emit(render(rows, format_, columns), output)


@labels.command("import")
@click.argument("yaml_file", metavar="YAML", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--rooms-of",
    default=DEFAULT_LABELS,
    show_default=True,
    metavar="NAME|DIR",
    shell_complete=complete_labels,
    help="The label space whose rooms to take; Hydra's file names none.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="The folder to write; its base name is the label space's name.",
)
def import_command(yaml_file: Path, rooms_of: str, output: Path) -> None:
    """Make a label space of the objects that a Hydra label-space YAML names.

    \b
    Example:
      roomtables labels import ade20k_mp3d_label_space.yaml -o ade20k
    """
    found = read_hydra_labels(yaml_file)
    rooms, known = load_labels(rooms_of).rooms, load_labels(DEFAULT_LABELS).objects
    space = to_label_space(found, output.resolve().name, rooms, known)
    save_labels(space, output)


@labels.command("from-rooms")
@click.argument("rooms_file", metavar="ROOMS", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="The folder to write; its base name is the label space's name.",
)
def from_rooms(rooms_file: Path, output: Path) -> None:
    """Make a label space of the objects and rooms that a room list names.

    \b
    Example:
      roomtables labels from-rooms rooms.jsonl -o mylabels
    """
    objects: set[str] = set()
    rooms: set[str] = set()
    for room in read_room_lines(rooms_file):
        objects.update(room.objects)
        rooms.update(room.truth)
    if not objects or not rooms:
        raise InputError(f"{rooms_file} names no object or no room; room lines need `room`")
    save_labels(LabelSpace.named(output.resolve().name, objects, rooms), output)


@labels.command()
@click.argument("given", metavar="FILE|NAME...", nargs=-1, required=True)
@labelspace_option
@tables_option
@labels_option
@format_option()
@output_option
def check(
    given: tuple[str, ...],
    labelspace: Path | None,
    tables: Path,
    labels: str | None,
    format_: str,
    output: Path | None,
) -> None:
    """Say how much of a scene, a room list, a Hydra label-space YAML or of NAMEs is understood.

    Each distinct name is shown with the object that it is read as, and how (label, plural, synonym,
    spelling, compound); those not understood come first, with the nearest names that are known.
    Names are read as the published tables read them, or the label space where there are none.

    \b
    Example:
      roomtables labels check rooms.jsonl
      roomtables labels check ade20k_full_label_space.yaml --labels mpcat40
      roomtables labels check DiningTable chair_12 "wooden stool"
    """
    reader = NameReader(_object_names(tables, labels))
    rows = check_names(reader, Counter(_names_in(given, labelspace)))
    columns = ("name", "times", "object", "how", "nearest")
    text = render([row.as_json() for row in rows], format_, columns)
    if format_ == "table":
        emit(f"{text}\n{summary(rows)}\n", output)
    else:
        emit(text, output)
        echo(summary(rows), err=True)


def _object_names(tables: Path, labels: str | None) -> Mapping[str, Name]:
    """The names of objects as published tables read them, else as the label space does."""
    published = {*published_labels(tables), *published_labels(tables / "tables")}
    if published if labels is None else labels_name(labels) in published:
        opened = RoomTables.open(tables, labels, offline=True, note_misses=False)
        return opened.lookup.object_names()
    return find_labels(labels or DEFAULT_LABELS, tables).object_names


def _names_in(given: Iterable[str], labelspace: Path | None) -> Iterable[str]:
    """The names of objects in files, each as often as it occurs, and the names that are no file."""
    for argument in given:
        path = Path(argument)
        if path.suffix.casefold() in _YAML:
            found = read_hydra_labels(path)
            yield from (found.names[label] for label in found.objects or found.names)
        elif argument == "-" or path.suffix.casefold() in _SUFFIXES or path.exists():
            for room in read_rooms(argument, labelspace=labelspace, warn=Warnings()):
                yield from room.objects
        else:
            yield argument


def save_labels(space: LabelSpace, folder: Path) -> None:
    """Write a label space's files and say so.

    Raises
    ------
    InputError
        The folder holds a label space already, or cannot be written.
    """
    if (folder / "objects.csv").exists() or (folder / "rooms.csv").exists():
        raise InputError(f"{folder} holds a label space already; give another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}") from error
    files = {folder / name: text for name, text in space.csv_files().items()}
    try:
        for path, text in files.items():
            write_aside(path, text.encode())
    except BaseException:  # half a label space would be in the way of the next try
        for path in files:
            path.unlink(missing_ok=True)
        raise
    echo(
        f"wrote {folder}: {len(space.objects)} objects, {len(space.rooms)} rooms; "
        f"now run `roomtables build --labels {folder}`"
    )
