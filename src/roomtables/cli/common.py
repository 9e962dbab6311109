"""What commands share: options, errors and warnings, and results as table, JSON, CSV or names."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from numbers import Number
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click
from tqdm import tqdm

from roomtables import __version__
from roomtables.cli.checks import check_arguments, check_room
from roomtables.cli.printing import (
    as_json,
    as_json_line,
    csv_cell,
    echo,
    in_one_line,
    log_to_stderr,
)
from roomtables.errors import RoomtablesError
from roomtables.labels import normalise
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.rooms import MEASURES, Room
from roomtables.scenes.dsg import NamedRoom
from roomtables.schemas import RULES, SOURCES
from roomtables.storage.files import write_aside
from roomtables.storage.refusals import refusal

Command = TypeVar("Command", bound=Callable[..., Any])

FORMATS = ("table", "json", "jsonl", "csv")
INTERRUPTED = 130
_MOST_NAMES = 65_536  # answers whose names a Namer remembers
_MOST_SHOWN = 12  # synonyms that are told of


class Group(click.Group):
    """A group of commands whose errors are one line on stderr and exit code 1."""

    def invoke(self, ctx: click.Context) -> Any:
        log_to_stderr()
        try:
            return super().invoke(ctx)
        except RoomtablesError as error:
            _end(ctx, error)
        except BrokenPipeError:
            # The reader of our output left: nothing more to say, not even at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            ctx.exit(1)
        except KeyboardInterrupt:
            click.echo("interrupted; what is scored is kept", err=True)
            ctx.exit(INTERRUPTED)
        except click.ClickException as error:
            said = io.StringIO()
            error.show(said)
            echo(said.getvalue(), err=True, nl=False)
            ctx.exit(error.exit_code)
        except Exception as error:  # what is no refusal of the system is a bug, and shows as one
            refused = refusal(error, doing="use")
            if refused is None:
                raise
            _end(ctx, refused)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        check_arguments(args)
        name, command, rest = super().resolve_command(ctx, args)
        check_room(name or "")
        return name, command, rest


def _end(ctx: click.Context, error: RoomtablesError) -> NoReturn:
    """Say in one line what to correct, and exit with code 1."""
    echo(f"error: {' '.join(str(error).split())}", err=True)
    ctx.exit(1)


tables_option = click.option(
    "--tables",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("tables"),
    show_default=True,
    help="The tables folder.",
)
labels_option = click.option(
    "--labels", default="mpcat40", show_default=True, help="Label space: a name, or its folder."
)
output_option = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write to a file instead of stdout.",
)
labelspace_option = click.option(
    "--labelspace",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Hydra's label-space YAML, for a graph that does not name its labels.",
)
mapping_option = click.option(
    "--category-mapping",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Matterport's category_mapping.tsv, for the nyuClass of .house files.",
)


def format_option(*formats: str, default: str = "table") -> Callable[[Command], Command]:
    """``--format`` with the given choices."""
    return click.option(
        "--format",
        "format_",
        type=click.Choice(formats or FORMATS),
        default=default,
        show_default=True,
        help="How to print. In csv, text that a spreadsheet would run gets a ' in front.",
    )


def _rooms(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    return None if value is None else tuple(value.split(","))


def _temperature(ctx: click.Context, param: click.Parameter, value: str | None) -> Any:
    if value in {None, "auto"}:
        return value
    try:
        return float(str(value))
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither a number nor `auto`") from None


weights_option = click.option(
    "--weights", type=click.Choice(MEASURES), help="What room lines say of each object counts."
)


def decision_options(command: Command) -> Command:
    """Options that say how a room is decided; absent ones are as the tables were built."""
    for option in reversed(
        (
            click.option("--rule", type=click.Choice(RULES), help="How a room is decided."),
            click.option("--source", type=click.Choice(SOURCES), help="Whose p(room | object)."),
            click.option("--rooms", callback=_rooms, help="Candidate rooms, separated by commas."),
            click.option("--prior-weight", type=float, help="λ of rules calibrated and pooled."),
            click.option("--evidence-power", type=float, help="γ of rule pooled."),
            click.option("--temperature", callback=_temperature, help="A number, or auto."),
            click.option("--min-probability", type=float, help="Below it a room stays unknown."),
            click.option("--offline", is_flag=True, help="Never load a language model."),
        )
    ):
        command = option(command)
    return command


def render(
    rows: Sequence[Mapping[str, Any]], format_: str, columns: Sequence[str] | None = None
) -> str:
    """Rows as text; ``json`` is a list of them."""
    names = list(columns if columns is not None else rows[0] if rows else ())
    if format_ == "json":
        return as_json([dict(row) for row in rows])
    if format_ == "jsonl":
        return "".join(as_json_line(row) for row in rows)
    if format_ == "csv":  # for programs: nothing rounded
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(map(csv_cell, names))
        writer.writerows([_csv_cell(row.get(name)) for name in names] for row in rows)
        return buffer.getvalue()
    from tabulate import tabulate

    cells = [[in_one_line(_cell(row.get(name), ".4g")) for name in names] for row in rows]
    headers = [in_one_line(name) for name in names]
    return tabulate(cells, headers=headers, tablefmt="simple", disable_numparse=True) + "\n"


def emit(text: str, output: Path | None = None) -> None:
    """Print, or write the file whole."""
    if output is None:
        echo(text, nl=False)
    else:
        write_aside(output, text.encode(errors="backslashreplace"))


def emit_lines(lines: Iterable[str], output: Path | None) -> None:
    """Print lines as they come, or write the file whole."""
    if output is not None:
        emit("".join(lines), output)
        return
    for line in lines:
        echo(line, nl=False)


def _cell(value: Any, float_format: str) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return format(value, float_format)
    if isinstance(value, list | tuple):
        return ", ".join(_cell(item, float_format) for item in value)
    return str(value)


def _csv_cell(value: Any) -> str:
    text = _cell(value, "")
    return text if isinstance(value, Number) else csv_cell(text)


class Warnings:
    """Prints each warning once, above a progress bar."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def __call__(self, message: str) -> None:
        if message not in self._said:
            self._said.add(message)
            tqdm.write(f"warning: {in_one_line(message)}", file=sys.stderr)


class Namer:
    """Makes names of answers; an answer that was named before costs a dictionary lookup."""

    def __init__(self, tables: RoomTables) -> None:
        manifest = tables.version.manifest
        self._shared = {
            "model": manifest.query_scorer_id or manifest.scorer_id,
            "labels": manifest.labels,
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


class Synonyms:
    """Collects the synonyms among the names of rooms that pass through it."""

    def __init__(self, tables: RoomTables) -> None:
        self._labels = tables.lookup.object_aliases
        self._plurals = {entry.label: normalise(entry.plural) for entry in tables.lookup.objects}
        self._used: dict[str, str] = {}

    def watch(self, rooms: Iterable[Room]) -> Iterator[Room]:
        """The rooms, unchanged."""
        for room in rooms:
            for name in room.objects:
                spelled = normalise(name)
                label = self._labels.get(spelled)
                if label is not None and spelled not in (label, self._plurals[label]):
                    self._used[spelled] = label
            yield room

    def report(self) -> None:
        """One line on stderr, if there was any."""
        if self._used:
            pairs = [f"{name} = {label}" for name, label in sorted(self._used.items())]
            more = ", …" if len(pairs) > _MOST_SHOWN else ""
            shown = ", ".join(pairs[:_MOST_SHOWN])
            echo(f"read as synonyms: {shown}{more}", err=True)
