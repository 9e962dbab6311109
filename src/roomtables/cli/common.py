"""What commands share: options, errors and warnings, and results as table, JSON, CSV or names."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Number
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click

from roomtables.cli.checks import check_arguments, check_room
from roomtables.cli.completion import complete_labels
from roomtables.cli.folding import Grid, fit, table_width
from roomtables.cli.interrupts import end_interrupted, interruptible, noticing_interrupts
from roomtables.cli.printing import (
    as_json,
    as_json_line,
    csv_cell,
    echo,
    in_one_line,
    log_to_stderr,
)
from roomtables.cli.progress import write_line
from roomtables.config import DEFAULT_LABELS
from roomtables.errors import RoomtablesError, needing
from roomtables.rooms import MEASURES
from roomtables.schemas import RULES, SOURCES
from roomtables.storage.files import write_aside
from roomtables.storage.refusals import refusal

Command = TypeVar("Command", bound=Callable[..., Any])

FORMATS = ("table", "json", "jsonl", "csv")


class Group(click.Group):
    """A group of commands whose errors are one line on stderr and exit code 1.

    Interrupted, by SIGINT or SIGTERM, they exit with code 130.
    """

    def main(self, *args: Any, **kwargs: Any) -> Any:
        with interruptible():
            return super().main(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        log_to_stderr()
        try:
            with noticing_interrupts(), needing("this command"):
                return super().invoke(ctx)
        except RoomtablesError as error:
            _end(ctx, error)
        except BrokenPipeError:
            # The reader of our output left: nothing more to say, not even at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            ctx.exit(1)
        except KeyboardInterrupt:
            end_interrupted(ctx)
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
    "--labels",
    shell_complete=complete_labels,
    help="Label space: a name, or its folder.  "
    f"[default: {DEFAULT_LABELS} where it is published, else the only one that is]",
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


def _unless(ctx: click.Context, param: click.Parameter, value: bool) -> bool:
    return not value


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
            click.option(
                "--no-backoff",
                "backoff",
                is_flag=True,
                callback=_unless,
                help="Leave rooms unanswered that neither table nor model can answer by the rule.",
            ),
        )
    ):
        command = option(command)
    return command


def render(
    rows: Sequence[Mapping[str, Any]],
    format_: str,
    columns: Sequence[str] | None = None,
    *,
    beneath: Sequence[str] = (),
    repeated: int = 0,
) -> str:
    """Rows as text; ``json`` is a list of them.

    A ``table`` on a terminal is no wider than that; ``beneath`` and ``repeated`` say how it is made
    to fit (:func:`roomtables.cli.folding.fit`).
    """
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
    cells = [[in_one_line(_cell(row.get(name), ".4g")) for name in names] for row in rows]
    grid = Grid([in_one_line(name) for name in names], cells)
    width = table_width()
    grids, lines = ([grid], []) if width is None else fit(grid, width, beneath, repeated)
    return "\n".join(map(_table, grids)) + "".join(f"{line}\n" for line in lines)


def _table(grid: Grid) -> str:
    from tabulate import tabulate

    return tabulate(grid.rows, headers=grid.names, tablefmt="simple", disable_numparse=True) + "\n"


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
            write_line(f"warning: {in_one_line(message)}")
