"""Commands that make tables and take them to a robot: build, plan, misses, export."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roomtables.cli.common import (
    Command,
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.completion import complete_labels
from roomtables.cli.printing import as_json, echo
from roomtables.config import DEFAULT_LABELS, ENGINES, NONE, BuildConfig, labels_name
from roomtables.errors import needing
from roomtables.schemas import REDUCTIONS
from roomtables.scorer import DTYPES, SCORINGS
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from roomtables.storage.places import shown
from roomtables.storage.sent_misses import fetch_misses
from roomtables.storage.spaces import find_space

if TYPE_CHECKING:
    from roomtables.offline.plan import Plan

_FILE = click.Path(path_type=Path, dir_okay=False)
_OPTIONS = (
    click.option("--config", type=_FILE, help="A build.toml; options win over it."),
    click.option(
        "--labels",
        shell_complete=complete_labels,
        help=f"Label space: a name, or its folder.  [default: {DEFAULT_LABELS}]",
    ),
    click.option(
        "--model", help="Hub name, folder, or FILE.gguf.  [default: household-lm, embedded]"
    ),
    click.option("--revision", help="Branch, tag or commit of a hub model."),
    click.option("--dtype", type=click.Choice(DTYPES), help="Compute precision."),
    click.option("--device", help="auto, cpu or cuda.  [default: auto]"),
    click.option("--scoring", type=click.Choice(SCORINGS), help="Force the kind of scoring."),
    click.option("-k", type=int, help="Objects in a query sentence.  [default: 3]"),
    click.option("--reduction", type=click.Choice(REDUCTIONS), help="Of log probabilities."),
    click.option("--smoothing", type=float, help="Added to each count.  [default: 1 / rooms]"),
    click.option("--counts", type=_FILE, help="CSV (object, room, count), or labelled room lines."),
    click.option("--scores", type=_FILE, help="CSV of scores that stand in for the model."),
    click.option(
        "--combinations",
        help="all, none, misses, or a file of room lines.  "
        "[default: auto: all up to two million sentences, else misses]",
    ),
    click.option("--engine", type=click.Choice(ENGINES), help="Where sentences are scored."),
    click.option("--workers", type=int, help="Of engine ray.  [default: as many as fit]"),
    click.option("--full-refresh", is_flag=True, default=None, help="Score everything afresh."),
)


def build_options(command: Command) -> Command:
    """The options that `build` and `plan` share."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@click.command("build")
@build_options
@tables_option
@click.option("--misses-from", metavar="URL", help="A place where robots push their misses.")
@click.option("--wait", is_flag=True, help="Wait for another build in this folder to end.")
@format_option("table", "json")
def build_command(
    config: Path | None,
    tables: Path,
    misses_from: str | None,
    wait: bool,
    format_: str,
    **options: Any,
) -> None:
    """Build and publish the tables of a label space.

    Only what is missing is scored; a build that is stopped goes on where it was.

    \b
    Example:
      roomtables build
      roomtables build --model ./gpt2 --dtype bfloat16 --combinations rooms.jsonl
      roomtables build --model SmolLM2-135M-Instruct.Q4_1.gguf --combinations none
      roomtables build --combinations misses --misses-from s3://bucket/tables
    """
    with needing("`roomtables build`", "lm"):
        from roomtables.offline.builder import build

    found = BuildConfig.load(config, **options)
    if misses_from is not None:
        _fetch_misses(found, tables, misses_from)
    report = build(found, tables=tables, progress=sys.stderr.isatty(), wait=wait)
    if format_ == "json":
        emit(as_json(report.as_json()))
        return
    done = "published" if report.published else "up to date:"
    echo(
        f"{done} {report.labels} {report.version} in {tables}: "
        f"{report.sentences_scored:,} sentences scored, {report.sentences_cached:,} cached, "
        f"{report.seconds:.1f} s"
    )


def _fetch_misses(config: BuildConfig, tables: Path, url: str) -> None:
    """Bring what robots asked for in vain into the tables folder, for the build to read."""
    if config.combinations == NONE:
        raise click.UsageError("--misses-from asks for combinations: leave out --combinations none")
    done = fetch_misses(tables, labels_name(config.labels), url)
    if done.files or done.skipped:
        click.echo(
            f"fetched {done.files} files of misses, {done.skipped} skipped: {shown(url)}", err=True
        )


@click.command("plan")
@build_options
@tables_option
@click.option("--exact", is_flag=True, help="Count what the cache lacks; of many, this takes long.")
@format_option("table", "json")
@output_option
def plan_command(
    config: Path | None,
    tables: Path,
    exact: bool,
    format_: str,
    output: Path | None,
    **options: Any,
) -> None:
    """Say what `build` would do with the same options, and why; nothing is written.

    Sentences to score are counted by formula: at most so many. With --exact they are those that
    `build` then scores, unless which ones it asks depends on scores that are still to come.

    \b
    States: cached (nothing to do), missing, stale (made from what has changed since).

    \b
    Example:
      roomtables plan --labels mpcat40 --format json
      roomtables plan --exact
    """
    with needing("`roomtables plan`", "lm"):
        from roomtables.offline.plan import plan

    found = plan(BuildConfig.load(config, **options), tables=tables, exact=exact)
    emit(as_json(found.as_json()) if format_ == "json" else _plan_text(found), output)


def _plan_text(plan: Plan) -> str:
    """The plan as a person reads it: stages, what they cost, what they cover."""
    rows = [
        {
            "stage": stage.stage,
            "state": stage.state,
            "why": stage.why,
            "sentences": f"{stage.sentences:,}" if stage.sentences else "",
        }
        for stage in plan.stages
    ]
    cover = plan.coverage
    most = "" if plan.exact else "at most "
    partly = most if 0 < cover.held < cover.combinations else ""
    return (
        f"{plan.labels}: {plan.published or 'nothing is published'}\n"
        f"model: {plan.scorer_id or 'none is asked'}\n\n"
        f"{render(rows, 'table')}\n"
        f"to score: {most}{plan.sentences_to_score:,} sentences{_cost(plan)}\n"
        f"combinations held now: {plan.held:,}; "
        f"after the build: {partly}{cover.held:,} of {cover.combinations:,}\n"
        f"{_rest(cover.rest_sentences, cover.rest_seconds)}"
    )


def _cost(plan: Plan) -> str:
    if not plan.sentences_to_score:
        return ""
    cost = ""
    if plan.seconds is None:
        cost = "\n  (how long that takes shows after the first build of this model)"
    else:
        cost = (
            f"\n  {plan.tokens or 0:,} tokens, {_duration(plan.seconds)} at "
            f"{plan.sentences_per_second:,.0f} sentences a second"
        )
    return cost if plan.exact else f"{cost}\n  (`plan --exact` looks into the cache)"


def _rest(sentences: int, seconds: float | None) -> str:
    if not sentences:
        return ""
    takes = "" if seconds is None else f", {_duration(seconds)}"
    return f"the rest would take {sentences:,} sentences{takes}\n"


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours:,} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"


_MISS_COLUMNS = ("source", "objects", "times_asked", "last_asked")


@click.command("misses")
@tables_option
@labels_option
@format_option()
@output_option
def misses_command(tables: Path, labels: str | None, format_: str, output: Path | None) -> None:
    """List the combinations of known objects that were asked for and that no table held.

    `build --combinations misses` puts them into the tables; then they are listed no more.

    \b
    Example:
      roomtables misses --format csv
    """
    space = find_space(tables, labels)
    if not space.path.is_dir():
        space.current()  # says what is missing, and what there is
    rows = [
        miss._asdict() | {"objects": list(miss.objects), "last_asked": miss.last_asked.isoformat()}
        for miss in Misses.read(space.path / FOLDER).open
    ]
    emit(render(rows, format_, _MISS_COLUMNS), output)


@click.command("export")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("tables.tar.zst"),
    show_default=True,
    help="The archive: .tar.zst, .tar.gz or .tar.",
)
@click.option(
    "--with-model",
    is_flag=True,
    help="The model, too, in ONNX: it answers what no table holds, without torch.",
)
@tables_option
@labels_option
def export_command(output: Path, with_model: bool, tables: Path, labels: str | None) -> None:
    """Pack the published tables for a robot: what a lookup needs, in one archive.

    \b
    Example:
      roomtables export -o tables.tar.zst
      tar --zstd -xf tables.tar.zst        # on the robot
    """
    from roomtables.offline.robot_model import write_robot_model
    from roomtables.storage.export import export

    space = find_space(tables, labels).labels
    packed = export(tables, space, output, write_robot_model if with_model else None)
    for found in packed:
        echo(
            f"{found.source}: {found.combinations:,} combinations x {found.rooms} rooms, "
            f"{_megabytes(found.bytes)} unpacked"
        )
    echo(f"{output}: {_megabytes(output.stat().st_size)}")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.2f} MB"
