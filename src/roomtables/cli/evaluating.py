"""Commands that judge the labels: evaluate, paper, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    decision_options,
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
    weights_option,
)
from roomtables.cli.names import NameReport
from roomtables.cli.printing import as_json, echo
from roomtables.evaluation import Evaluation, evaluate
from roomtables.evaluation.comparison import (
    Comparison,
    PairedTest,
    Sweep,
    compare,
    parse_conditions,
    sweep,
)
from roomtables.online.classifier import RoomTables

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command("evaluate")
@click.argument("rooms_file", metavar="ROOMS", type=_FILE)
@click.option("--compare", "conditions", metavar="RULE:SOURCE,…", help="Several in one run.")
@click.option("--sweep", "sweeps", is_flag=True, help="Accuracy over k, λ, γ, rule and source.")
@click.option("--statistics", is_flag=True, help="Add interval, top 3 and calibration to JSON.")
@click.option("--plot", type=_FILE, help="Draw accuracy per room, or the sweep: .png or .svg.")
@click.option("--plot-calibration", type=_FILE, help="Draw reliability, and risk over coverage.")
@tables_option
@labels_option
@decision_options
@weights_option
@format_option("table", "json")
@output_option
def evaluate_command(
    rooms_file: Path,
    conditions: str | None,
    sweeps: bool,
    statistics: bool,
    plot: Path | None,
    plot_calibration: Path | None,
    weights: str | None,
    tables: Path,
    labels: str | None,
    format_: str,
    output: Path | None,
    **decision: Any,
) -> None:
    """Compare answers with the true labels of ROOMS (room lines).

    \b
    Example:
      roomtables evaluate rooms.jsonl --rule pooled
      roomtables evaluate rooms.jsonl --compare query:proxy,pooled:proxy --plot rooms.svg
      roomtables evaluate rooms.jsonl --sweep --plot sweep.png
    """
    if sweeps and (conditions or statistics or plot_calibration or weights):
        raise click.UsageError("--sweep goes with --plot alone")
    check_plots(plot, plot_calibration)
    asked = parse_conditions(conditions) if conditions else ()
    opened = RoomTables.open(tables, labels, **decision)
    as_text = format_ != "json"
    if sweeps:
        swept = sweep(rooms_file, opened)
        emit(_sweep_text(swept) if as_text else as_json(swept.as_json()), output)
        _draw("sweep", swept, plot)
        return
    if asked:
        compared = compare(rooms_file, opened, asked, weights)
        emit(_comparison_text(compared) if as_text else as_json(compared.as_json()), output)
        evaluations = compared.evaluations
    else:
        result = evaluate(rooms_file, opened, weights)
        names = NameReport.of(opened)
        for judged in result.judged:
            names.take(judged.prediction)
        click.get_current_context().call_on_close(names.print)
        emit(
            _summary(result) if as_text else as_json(result.as_json(statistics=statistics)), output
        )
        evaluations = (result,)
    _draw("per_room", evaluations, plot)
    _draw("calibration", evaluations, plot_calibration)


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


def _summary(result: Evaluation) -> str:
    rows = [{"room": label, **row} for label, row in result.per_room().items()]
    baselines = result.baselines()
    found = result.as_json(statistics=True)
    more = found["statistics"]
    interval = more["accuracy_interval"]
    lines = [
        f"{result.correct} of {result.rooms} rooms right: {result.accuracy:.1%} "
        f"(macro {result.macro_accuracy:.1%}), rule {result.rule}, source {result.source}",
        f"95 % interval {interval['low']:.1%} to {interval['high']:.1%}; "
        f"right among the top 3: {more['top_3_accuracy']:.1%}; "
        f"expected calibration error {more['expected_calibration_error']:.3f}",
        f"baselines: uniform {baselines['uniform']:.1%}, majority {baselines['majority']:.1%}",
        f"answered by: {_counts(found['answered_by'])}; backed off to rule pooled: "
        f"{found['backed_off']}; left out: {_counts(found['skipped'])}",
    ]
    return "\n".join(lines) + "\n\n" + render(rows, "table")


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{what} {n}" for what, n in sorted(counts.items())) or "none"


def _comparison_text(compared: Comparison) -> str:
    """A table of the conditions, one of the tests between them, one of accuracy per room."""
    conditions = [_condition_row(found) for found in compared.evaluations]
    tests = [_test_row(test) for test in compared.paired_tests()]
    per_room: dict[str, dict[str, Any]] = {}
    for found in compared.evaluations:
        for room, row in found.per_room().items():
            line = per_room.setdefault(room, {"room": room, "rooms": row["rooms"]})
            line[found.condition] = f"{row['accuracy']:.1%}"
    parts = [conditions, *([tests] if tests else []), [per_room[room] for room in sorted(per_room)]]
    return "\n".join(render(rows, "table") for rows in parts)


def _condition_row(found: Evaluation) -> dict[str, Any]:
    more = found.statistics()
    interval = more["accuracy_interval"]
    return {
        "condition": found.condition,
        "rooms": found.rooms,
        "correct": found.correct,
        "accuracy": f"{found.accuracy:.1%}",
        "95 % interval": f"{interval['low']:.1%} to {interval['high']:.1%}",
        "macro": f"{found.macro_accuracy:.1%}",
        "top 3": f"{more['top_3_accuracy']:.1%}",
        "calibration error": f"{more['expected_calibration_error']:.3f}",
        "unanswered": sum(judged.prediction.room is None for judged in found.judged),
    }


def _test_row(test: PairedTest) -> dict[str, Any]:
    return {
        "first": test.first,
        "second": test.second,
        "difference": f"{test.difference:+.1%}",
        "95 % interval": f"{test.low:+.1%} to {test.high:+.1%}",
        "only first right": test.only_first,
        "only second right": test.only_second,
        "McNemar p": f"{test.p_value:.2g}",
    }


def _sweep_text(swept: Sweep) -> str:
    rows = [
        row | {"k": row["k"] or "all", "accuracy": f"{row['accuracy']:.1%}"}
        for row in swept.as_json()["sweep"]
    ]
    notes = "".join(f"not varied: {note}\n" for note in swept.notes)
    return render(rows, "table") + "\n" + notes


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
