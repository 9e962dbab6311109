"""Charts of evaluations and sweeps: accuracy per room, calibration, and the grid of settings.

matplotlib, of the extra ``report``, is imported when a chart is drawn. Every ``…_figure`` function
returns a ``matplotlib.figure.Figure``, and raises MissingExtraError where matplotlib is absent.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from roomtables.errors import InputError, needing
from roomtables.evaluation import Evaluation
from roomtables.evaluation.sweeping import Sweep, SweepPoint
from roomtables.report.text import drawn
from roomtables.schemas import POOLED, PROXY
from roomtables.storage.files import write_aside
from roomtables.wording import percent

FORMATS = (".png", ".svg")
_COLOURS = ("#4269d0", "#efb118", "#ff725c", "#6cc5b0", "#3ca951", "#ff8ab7", "#a463f2", "#97bbf5")
_DOTS_PER_INCH = 130
_LINE = 150  # characters of a line beneath a picture


def check_plot(path: Path) -> None:
    """See, before any work, that a picture can be drawn to a path.

    Raises
    ------
    InputError
        The path does not end in .png or .svg.
    MissingExtraError
        matplotlib is not installed.
    """
    if path.suffix.casefold() not in FORMATS:
        raise InputError(f"cannot draw to {path}: give a file that ends in .png or .svg")
    _figure(1, 1)


def save(figure: Any, path: Path) -> None:
    """Write a figure to a path whose suffix says the format: .png or .svg."""
    write_aside(path, rendered(figure, path.suffix.casefold().removeprefix(".")))


def rendered(figure: Any, format_: str) -> bytes:
    """A figure as PNG or SVG; the same figure gives the same bytes."""
    import matplotlib

    buffer = io.BytesIO()
    metadata = {"Date": None} if format_ == "svg" else {}
    with matplotlib.rc_context({"svg.hashsalt": "roomtables", "svg.fonttype": "none"}):
        figure.savefig(buffer, format=format_, metadata=metadata, dpi=_DOTS_PER_INCH)
    return buffer.getvalue()


def per_room_figure(evaluations: Sequence[Evaluation], names: Sequence[str] = ()) -> Any:
    """The paper's bar chart: accuracy by true room label, one bar per condition."""
    names = [drawn(name) for name in names or [found.condition for found in evaluations]]
    tables = [found.per_room() for found in evaluations]
    rooms = sorted({room for table in tables for room in table})
    figure = _figure(max(6.0, 0.34 * len(rooms) * max(1.0, len(names) / 2.5) + 1.5), 4.2)
    axes = figure.add_subplot()
    width = 0.84 / len(names)
    for number, (name, found, table) in enumerate(zip(names, evaluations, tables, strict=True)):
        at = np.arange(len(rooms)) + (number - (len(names) - 1) / 2) * width
        heights = [100 * table[room]["accuracy"] if room in table else 0 for room in rooms]
        label = f"{name}: {percent(found.accuracy)} of {found.rooms}{_not_by_rule(found)}"
        axes.bar(at, heights, width, label=label, color=_COLOURS[number % len(_COLOURS)])
    counts = {room: row["rooms"] for table in tables for room, row in table.items()}
    axes.set_xticks(
        np.arange(len(rooms)), [drawn(f"{room} ({counts[room]})") for room in rooms], rotation=60,
        ha="right", rotation_mode="anchor",
    )  # fmt: skip
    axes.set(ylabel="accuracy (%)", ylim=(0, 100), xlim=(-0.6, len(rooms) - 0.4))
    axes.yaxis.grid(alpha=0.3)
    axes.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=min(2, len(names)), frameon=False)
    return figure


def _not_by_rule(found: Evaluation) -> str:
    """How many rooms have no answer, or one by another rule; empty where none has."""
    numbers = {"unanswered": found.unanswered.total(), "backed off": found.backed_off}
    return "".join(f", {n} {what}" for what, n in numbers.items() if n)


def calibration_figure(evaluations: Sequence[Evaluation], names: Sequence[str] = ()) -> Any:
    """Left the reliability diagram, right the share wrong against the share answered."""
    names = [drawn(name) for name in names or [found.condition for found in evaluations]]
    figure = _figure(9.0, 4.2)
    left, right = figure.subplots(1, 2)
    left.plot([0, 1], [0, 1], color="0.6", linestyle=":", label="calibrated")
    for number, (name, found) in enumerate(zip(names, evaluations, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        bins = found.reliability()
        left.plot(
            [b.mean_probability for b in bins], [b.accuracy for b in bins], color=colour, zorder=3
        )
        sizes = [12 + 200 * b.rooms / found.rooms for b in bins]
        left.scatter(
            [b.mean_probability for b in bins], [b.accuracy for b in bins], s=sizes, color=colour,
            alpha=0.6, label=name, zorder=3,
        )  # fmt: skip
        points = found.risk_coverage()
        right.plot(
            [p.coverage for p in points], [1 - p.accuracy for p in points], color=colour, label=name
        )
    left.set(xlabel="probability of the answer", ylabel="share right", xlim=(0, 1), ylim=(0, 1))
    right.set(xlabel="share of rooms answered", ylabel="share wrong", xlim=(0, 1), ylim=(0, 1))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize="small", loc="upper left")
    return figure


def sweep_figure(sweep: Sweep) -> Any:
    """Left accuracy over λ and γ of rule pooled, source proxy; right over k, by rule and source.

    Beneath stand the rooms without an answer, and the k that the tables do not hold.
    """
    figure = _figure(9.6, 4.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1))
    _draw_grid(left, [p for p in sweep.points if _in_grid(p)])
    styles = iter(_COLOURS)
    for name, points in _lines_over_k(sweep.points):
        ks, accuracies = [p.k for p in points], [100 * p.accuracy for p in points]
        right.plot(ks, accuracies, marker="o", label=name, color=next(styles, "0.3"))
    right.set(xlabel="k, most informative objects used", ylabel="accuracy (%)", ylim=(0, 100))
    right.set_xticks(range(1, sweep.k + 1))  # those not held, too
    right.set_xlim(0.8, sweep.k + 0.2)
    if beneath := _beneath(sweep):
        figure.supxlabel(beneath, fontsize="x-small", x=0.01, ha="left")
    right.grid(alpha=0.3)
    right.legend(frameon=False, fontsize="x-small")
    return figure


def _beneath(sweep: Sweep) -> str:
    """What a picture of a sweep leaves out or counts as wrong."""
    lines = [f"not drawn: {line}" for line in sweep.not_held]
    if left := max((point.unanswered for point in sweep.points), default=0):
        lines.append(f"counted as wrong: up to {left} of {sweep.points[0].rooms} rooms unanswered")
    return "\n".join("\n".join(textwrap.wrap(line, _LINE)) for line in lines)


def _in_grid(point: SweepPoint) -> bool:
    return (point.rule, point.source, point.k) == (POOLED, PROXY, None)


def _draw_grid(axes: Any, points: Sequence[SweepPoint]) -> None:
    """A cell per λ and γ, coloured and labelled by its accuracy in percent."""
    weights = sorted({p.prior_weight or 0.0 for p in points})
    powers = sorted({p.evidence_power or 0.0 for p in points})
    cells = np.full((len(powers), len(weights)), np.nan)
    for p in points:
        row, column = powers.index(p.evidence_power or 0.0), weights.index(p.prior_weight or 0.0)
        cells[row, column] = 100 * p.accuracy
        axes.text(column, row, f"{100 * p.accuracy:.1f}", ha="center", va="center", fontsize=9)
    if points:
        # Twice the best as the top of the scale keeps every cell light enough for black figures.
        highest = 2 * float(np.nanmax(cells))
        axes.imshow(cells, origin="lower", cmap="YlGn", aspect="auto", vmin=0, vmax=highest or 1)
    axes.set_xticks(range(len(weights)), [f"{w:g}" for w in weights])
    axes.set_yticks(range(len(powers)), [f"{p:g}" for p in powers])
    axes.set(xlabel="λ, prior weight", ylabel="γ, evidence power")
    axes.set_title("rule pooled, source proxy: accuracy (%)", fontsize="medium")


def _lines_over_k(points: Sequence[SweepPoint]) -> Iterator[tuple[str, list[SweepPoint]]]:
    """A name and the points over k for each rule and source, at the λ best at the largest k."""
    lines: dict[tuple[str, str], dict[float | None, list[SweepPoint]]] = {}
    for p in points:
        if p.k is not None:
            by_weight = lines.setdefault((p.rule, p.source), {})
            by_weight.setdefault(p.prior_weight, []).append(p)
    for (rule, source), by_weight in lines.items():
        weight = max(by_weight, key=lambda weight: by_weight[weight][-1].accuracy)
        shown = "" if weight is None else f", λ {weight:g}"
        yield f"{rule}, {source}{shown}", by_weight[weight]


def _figure(width: float, height: float) -> Any:
    with needing("drawing a picture"):
        from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")
