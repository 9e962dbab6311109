"""Commands that judge the labels: evaluate, paper, report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    decision_options,
    emit,
    format_option,
    labels_option,
    output_option,
    tables_option,
    weights_option,
)
from roomtables.cli.evaluation_text import comparison_text, evaluation_text, notes_text, sweep_text
from roomtables.cli.names import NameReport
from roomtables.cli.printing import echo
from roomtables.evaluation import Evaluation, evaluate
from roomtables.evaluation.comparison import compare, parse_conditions
from roomtables.evaluation.grouping import read_groups
from roomtables.evaluation.saving import save
from roomtables.evaluation.sweeping import sweep
from roomtables.online.classifier import RoomTables
from roomtables.storage.evaluations import check_evaluation_name

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command("evaluate")
@click.argument("rooms_file", metavar="ROOMS", type=_FILE)
@click.option("--compare", "conditions", metavar="RULE:SOURCE,…", help="Several in one run.")
@click.option("--sweep", "sweeps", is_flag=True, help="Accuracy over k, λ, γ, rule and source.")
@click.option("--statistics", is_flag=True, help="Add interval and calibration to JSON.")
@click.option("--groups", metavar="FILE.csv", help="Rooms as good as one another (room, group).")
@click.option("--plot", type=_FILE, help="Draw accuracy per room, or the sweep: .png or .svg.")
@click.option("--save", "name", metavar="NAME", help="Keep what was predicted, for `sql`.")
@click.option("--plot-calibration", type=_FILE, help="Draw reliability, and risk over coverage.")
@tables_option
@labels_option
@decision_options
@weights_option
@format_option("table", "json", "csv")
@output_option
def evaluate_command(
    rooms_file: Path,
    conditions: str | None,
    sweeps: bool,
    statistics: bool,
    groups: str | None,
    plot: Path | None,
    plot_calibration: Path | None,
    name: str | None,
    weights: str | None,
    tables: Path,
    labels: str | None,
    format_: str,
    output: Path | None,
    **decision: Any,
) -> None:
    """Compare answers with the true labels of ROOMS (room lines).

    A room without an answer counts as wrong, and is counted apart. With --save, SQL can ask about
    single rooms: `roomtables sql "from evaluations where predicted != room"`.

    --groups counts an answer that people use for the true one, too: FILE.csv names the group of
    each room; a built-in label space's name stands for the groups that it comes with.

    \b
    Example:
      roomtables evaluate rooms.jsonl --rule pooled --save nightly-1
      roomtables evaluate rooms.jsonl --compare query:proxy,pooled:proxy --plot rooms.svg
      roomtables evaluate rooms.jsonl --labels mpcat40 --groups mpcat40
      roomtables evaluate rooms.jsonl --sweep --plot sweep.png
    """
    if sweeps and (conditions or statistics or plot_calibration or weights or name or groups):
        raise click.UsageError("--sweep goes with --plot alone")
    check_plots(plot, plot_calibration)
    if name is not None:
        check_evaluation_name(name)
    asked = parse_conditions(conditions) if conditions else ()
    opened = RoomTables.open(tables, labels, **decision)
    if sweeps:
        _sweep(rooms_file, opened, format_, output, plot)
        return
    grouped = read_groups(groups, opened) if groups is not None else None
    if asked:
        compared = compare(rooms_file, opened, asked, weights, grouped)
        emit(comparison_text(compared, format_), output)
        evaluations = compared.evaluations
    else:
        found = evaluate(rooms_file, opened, weights, grouped)
        _report_names(opened, found)
        emit(evaluation_text(found, format_, statistics), output)
        evaluations = (found,)
    if name is not None:
        _save(evaluations, opened, name)
    _draw("per_room", evaluations, plot)
    _draw("calibration", evaluations, plot_calibration)


def _sweep(
    rooms: Path, tables: RoomTables, format_: str, output: Path | None, plot: Path | None
) -> None:
    swept = sweep(rooms, tables)
    emit(sweep_text(swept, format_), output)
    if format_ == "csv":  # which has no place for them
        echo(notes_text(swept), err=True, nl=False)
    _draw("sweep", swept, plot)


def _save(evaluations: Sequence[Evaluation], tables: RoomTables, name: str) -> None:
    path, replaced = save(evaluations, tables, name)
    rows = sum(found.rooms for found in evaluations)
    done = "replaced evaluation" if replaced else "saved evaluation"
    echo(f"{done} {name}: {rows} rows in {path}", err=True)


def _report_names(tables: RoomTables, result: Evaluation) -> None:
    """Tell at the end how the names in the rooms were read."""
    names = NameReport.of(tables)
    for judged in result.judged:
        names.take(judged.prediction)
    click.get_current_context().call_on_close(names.print)


def check_plots(*paths: Path | None) -> None:
    """Refuse a picture that cannot be drawn before the work is done."""
    if any(paths):
        from roomtables.report.plots import check_plot

        for path in filter(None, paths):
            check_plot(path)


def _draw(kind: str, drawn: object, path: Path | None) -> None:
    if path is None:
        return
    from roomtables.report import plots

    plots.save(getattr(plots, f"{kind}_figure")(drawn), path)
    echo(f"drew {path}", err=True)


@click.command("report")
@click.argument("rooms_file", metavar="[ROOMS]", required=False, type=_FILE)
@tables_option
@labels_option
@decision_options
@click.option("-o", "--output", type=_FILE, required=True, help="The HTML file to write.")
def report_command(
    rooms_file: Path | None, tables: Path, labels: str | None, output: Path, **decision: Any
) -> None:
    """Write one self-contained page about the tables; with labelled ROOMS also how they do.

    \b
    Example:
      roomtables report -o tables.html
      roomtables report rooms.jsonl --rule pooled -o tables.html
    """
    from roomtables.report.page import report

    text = report(RoomTables.open(tables, labels, **decision), rooms_file)
    emit(text, output)
    echo(f"wrote {output}")
