"""The command that reproduces the paper: its tables and its figure, from one's own rooms."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import emit, format_option, output_option, render
from roomtables.cli.completion import complete_labels
from roomtables.cli.evaluating import check_plots
from roomtables.cli.printing import as_json, echo
from roomtables.config import BuildConfig
from roomtables.errors import needing
from roomtables.evaluation.paper import Reproduction, Trial, reproduce
from roomtables.online.classifier import RoomTables
from roomtables.rooms import read_room_lines
from roomtables.schemas import QUERY, REDUCTIONS
from roomtables.scorer import DTYPES
from roomtables.wording import percent

_FILE = click.Path(path_type=Path, dir_okay=False)
_ROWS = {"ground_truth": "Ground truth co-occurrences", "proxy": "Proxy co-occurrences"}


@click.command("paper")
@click.argument("rooms", metavar="ROOMS…", nargs=-1, required=True, type=_FILE)
@click.option("--labels", multiple=True, default=("mpcat40",), show_default=True,
              shell_complete=complete_labels, help="Label space of each ROOMS.")  # fmt: skip
@click.option("--counts", multiple=True, type=_FILE, help="Counts for each ROOMS.")
@click.option("--scores", multiple=True, type=_FILE, help="Scores for each ROOMS, for the model's.")
@click.option("--model", help="Who scores.  [default: household-lm, unless there are scores]")
@click.option("--revision", help="Branch, tag or commit of a hub model.")
@click.option("--dtype", type=click.Choice(DTYPES), help="Compute precision; the paper's: float16.")
@click.option("--device", help="auto, cpu or cuda.  [default: auto]")
@click.option("--reduction", type=click.Choice(REDUCTIONS), help="The authors' code: mean.")
@click.option("--smoothing", type=float, help="Added to each count; the authors' code: 1 / rooms.")
@click.option(
    "--tables",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("paper-tables"),
    show_default=True,
    help="Where to build; apart from the tables in use.",
)
@click.option("--plot", type=_FILE, help="Draw the per-room figure: .png or .svg.")
@format_option("table", "json")
@output_option
def paper_command(
    rooms: tuple[Path, ...],
    labels: tuple[str, ...],
    counts: tuple[Path, ...],
    scores: tuple[Path, ...],
    tables: Path,
    plot: Path | None,
    format_: str,
    output: Path | None,
    **model: Any,
) -> None:
    """Print the paper's tables 1 and 2 for ROOMS, the published numbers beside ours.

    With two lists of rooms give --labels, --counts and --scores once for each, in their order.
    Scores without --model need no language model; then the paper's own rule, which asks one about
    query sentences, is left out.

    \b
    Example:
      roomtables paper rooms.jsonl --counts counts.csv --model EleutherAI/gpt-j-6b --dtype float16
    """
    for name, given in {"labels": labels, "counts": counts, "scores": scores}.items():
        if given and len(given) != len(rooms):
            raise click.UsageError(f"--{name}: give it once per ROOMS, {len(rooms)} times")
    check_plots(plot)
    with needing("`roomtables paper`", "lm"):
        from roomtables.offline.builder import build

    columns = []
    for at, file in enumerate(rooms):
        options = model | {
            "labels": labels[at],
            "counts": counts[at] if counts else None,
            "scores": scores[at] if scores else None,
            "combinations": "none" if scores and not model["model"] else str(file),
        }
        build(BuildConfig.load(None, **options), tables=tables, progress=sys.stderr.isatty())
        columns.append((RoomTables.open(tables, labels[at], offline=True), read_room_lines(file)))
    found = reproduce(columns)
    emit(as_json(found.as_json()) if format_ == "json" else _text(found), output)
    if plot is not None:
        _draw(found, plot)


def _text(found: Reproduction) -> str:
    shares = [
        {name: percent(v, 2) if isinstance(v, float) else v for name, v in row.items()}
        for row in found.table_1()
    ]
    accuracies: dict[tuple[str, str], dict[str, Any]] = {}
    missing = False
    for trial in found.trials:
        row = accuracies.setdefault(
            (trial.rule, trial.source), {"": _ROWS[trial.source], "rule": trial.rule}
        )
        row[f"{trial.labels}, paper"] = percent(trial.published, 2) if trial.published else ""
        row[f"{trial.labels}, ours"] = _ours(trial)
        missing |= trial.evaluation is None
    note = (
        "–: no table answers this; give --counts, or --model for the query sentences.\n"
        if missing
        else ""
    )
    return (
        "Table 1: room label frequencies\n\n" + render(shares, "table")
        + "\nTable 2: inference accuracies\n\n" + render(list(accuracies.values()), "table") + note
    )  # fmt: skip


def _ours(trial: Trial) -> str:
    row = trial.as_json()
    if row["accuracy"] is None:
        return "–"
    low, high = row["interval"]
    left = f", {row['unanswered']} unanswered" if row["unanswered"] else ""
    interval = f"{percent(low)} to {percent(high)}"
    return f"{percent(row['accuracy'], 2)} ({interval}, {row['rooms']} rooms{left})"


def _draw(found: Reproduction, path: Path) -> None:
    from roomtables.report.plots import per_room_figure, save

    shown = [trial for trial in found.trials if trial.evaluation is not None]
    names = [
        f"{trial.labels}, {_ROWS[trial.source].lower()}"
        + ("" if trial.rule == QUERY else f", {trial.rule}")
        for trial in shown
    ]
    save(per_room_figure([t.evaluation for t in shown if t.evaluation], names), path)
    echo(f"drew {path}", err=True)
