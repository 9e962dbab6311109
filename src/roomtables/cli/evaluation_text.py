"""Evaluations, comparisons and sweeps as text for people, as JSON, and as rows of CSV."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from roomtables.cli.common import render
from roomtables.cli.printing import as_json
from roomtables.evaluation import Evaluation
from roomtables.evaluation.comparison import Comparison, PairedTest
from roomtables.evaluation.sweeping import Sweep
from roomtables.wording import counts, percent

# What a narrow terminal shows last of each table, or in a line beneath.
_LEAST_OF_CONDITION = ("rooms", "calibration error", "top 3", "macro", "correct")
_LEAST_OF_POINT = ("reduction", "rooms", "unanswered")


def evaluation_text(found: Evaluation, format_: str, statistics: bool) -> str:
    """One evaluation: a summary and a table of the rooms, the latter as CSV, or JSON.

    ``statistics`` asks for those in JSON, too.
    """
    if format_ == "json":
        return as_json(found.as_json(statistics=statistics))
    rows = [{"room": label, **row} for label, row in found.per_room().items()]
    if format_ == "csv":
        return render(rows, "csv")
    shown = [row | {"accuracy": percent(row["accuracy"])} for row in rows]
    return f"{_summary(found)}\n\n{render(shown, 'table')}"


def _summary(found: Evaluation) -> str:
    statistics, baselines = found.statistics(), found.baselines()
    answered_by = found.as_json()["answered_by"]
    return (
        f"{found.correct} of {found.rooms} rooms right: {percent(found.accuracy)} "
        f"(macro {percent(found.macro_accuracy)})\n"
        f"rule {found.rule}, source {found.source}\n"
        f"95 % interval {_interval(statistics['accuracy_interval'])}; "
        f"right among the top 3: {percent(found.top_3_accuracy)}{_grouped(found)}\n"
        f"expected calibration error {statistics['expected_calibration_error']:.3f}; baselines: "
        f"uniform {percent(baselines['uniform'])}, majority {percent(baselines['majority'])}\n"
        f"answered by: {counts(answered_by)}; backed off to rule pooled: {found.backed_off}\n"
        f"unanswered, counted as wrong: {counts(found.unanswered)}\n"
        f"left out: {counts(found.skipped)}"
    )


def _grouped(found: Evaluation) -> str:
    share = found.grouped_accuracy
    return "" if share is None else f"; in the right group: {percent(share)}"


def _interval(found: Mapping[str, float]) -> str:
    return f"{percent(found['low'])} to {percent(found['high'])}"


def comparison_text(compared: Comparison, format_: str) -> str:
    """A table of the conditions, one of the tests between them, one of accuracy per room.

    CSV has the first alone.
    """
    if format_ == "json":
        return as_json(compared.as_json())
    if format_ == "csv":
        return render([_condition_record(found) for found in compared.evaluations], "csv")
    conditions = [_condition_row(found) for found in compared.evaluations]
    tests = [_test_row(test) for test in compared.paired_tests()]
    per_room: dict[str, dict[str, Any]] = {}
    for found in compared.evaluations:
        for room, row in found.per_room().items():
            line = per_room.setdefault(room, {"room": room, "rooms": row["rooms"]})
            line[found.condition] = percent(row["accuracy"])
    parts = [render(conditions, "table", beneath=_LEAST_OF_CONDITION)]
    if tests:
        parts.append(render(tests, "table", repeated=2))
    parts.append(render([per_room[room] for room in sorted(per_room)], "table", repeated=2))
    return "\n".join(parts)


def _condition_row(found: Evaluation) -> dict[str, Any]:
    more, grouped = found.statistics(), found.grouped_accuracy
    return {
        "condition": found.condition,
        "rooms": found.rooms,
        "correct": found.correct,
        "accuracy": percent(found.accuracy),
        "95 % interval": _interval(more["accuracy_interval"]),
        "macro": percent(found.macro_accuracy),
        "top 3": percent(found.top_3_accuracy),
        **({} if grouped is None else {"grouped": percent(grouped)}),
        "calibration error": f"{more['expected_calibration_error']:.3f}",
        "unanswered": found.unanswered.total(),
        "backed off": found.backed_off,
    }


def _condition_record(found: Evaluation) -> dict[str, Any]:
    more, grouped = found.statistics(), found.grouped_accuracy
    interval = more["accuracy_interval"]
    return {
        "rule": found.rule,
        "source": found.source,
        "rooms": found.rooms,
        "correct": found.correct,
        "accuracy": found.accuracy,
        "low": interval["low"],
        "high": interval["high"],
        "macro_accuracy": found.macro_accuracy,
        "top_3_accuracy": found.top_3_accuracy,
        **({} if grouped is None else {"grouped_accuracy": grouped}),
        "expected_calibration_error": more["expected_calibration_error"],
        "unanswered": found.unanswered.total(),
        "backed_off": found.backed_off,
    }


def _test_row(test: PairedTest) -> dict[str, Any]:
    low, high = percent(test.low, signed=True), percent(test.high, signed=True)
    return {
        "first": test.first,
        "second": test.second,
        "difference": percent(test.difference, signed=True),
        "95 % interval": f"{low} to {high}",
        "only first": test.only_first,
        "only second": test.only_second,
        "McNemar p": f"{test.p_value:.2g}",
    }


def sweep_text(swept: Sweep, format_: str) -> str:
    """A table of the settings, and a line for each thing that was not varied.

    CSV has the table alone.
    """
    if format_ == "json":
        return as_json(swept.as_json())
    if format_ == "csv":
        return render([asdict(point) for point in swept.points], "csv")
    rows = [
        {
            "reduction": point.reduction,
            "source": point.source,
            "rule": point.rule,
            "k": point.k or "all",
            "λ": point.prior_weight,
            "γ": point.evidence_power,
            "rooms": point.rooms,
            "correct": point.correct,
            "accuracy": percent(point.accuracy),
            "unanswered": point.unanswered,
        }
        for point in swept.points
    ]
    return f"{render(rows, 'table', beneath=_LEAST_OF_POINT)}\n{notes_text(swept)}"


def notes_text(swept: Sweep) -> str:
    """A line for each thing that was not varied."""
    return "".join(f"not varied: {note}\n" for note in swept.notes)
