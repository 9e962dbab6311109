"""Commands that make tables and look at them: build, status."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    as_json,
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.config import DTYPES, ENGINES, SCORINGS, BuildConfig
from roomtables.schemas import REDUCTIONS
from roomtables.store import SpaceFolder, Version

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command("build")
@click.option("--config", type=_FILE, help="A build.toml; options win over it.")
@click.option("--labels", help="Label space: a built-in name, or a folder.  [default: mpcat40]")
@tables_option
@click.option("--model", help="Hub name or local folder.  [default: household-lm, embedded]")
@click.option("--revision", help="Branch, tag or commit of a hub model.")
@click.option("--dtype", type=click.Choice(DTYPES), help="Compute precision.")
@click.option("--device", help="auto, cpu or cuda.  [default: auto]")
@click.option("--scoring", type=click.Choice(SCORINGS), help="Force the kind of scoring.")
@click.option("-k", type=int, help="Objects in a query sentence.  [default: 3]")
@click.option("--reduction", type=click.Choice(REDUCTIONS), help="Of log probabilities.")
@click.option("--smoothing", type=float, help="Added to each count.  [default: 1 / rooms]")
@click.option("--counts", type=_FILE, help="CSV (object, room, count), or labelled room lines.")
@click.option("--scores", type=_FILE, help="CSV of scores that stand in for the model.")
@click.option("--combinations", help="all, none, misses, or a file of room lines.")
@click.option("--engine", type=click.Choice(ENGINES), help="Where sentences are scored.")
@click.option("--full-refresh", is_flag=True, default=None, help="Score everything afresh.")
@format_option("table", "json")
def build_command(config: Path | None, tables: Path, format_: str, **options: Any) -> None:
    """Build and publish the tables of a label space.

    Only what is missing is scored; a build that is stopped goes on where it was.

    \b
    Example:
      roomtables build --labels mpcat40
      roomtables build --model ./gpt2 --dtype bfloat16 --combinations rooms.jsonl
    """
    from roomtables.offline.builder import build

    report = build(BuildConfig.load(config, **options), tables=tables, progress=sys.stderr.isatty())
    if format_ == "json":
        emit(as_json(report.as_json()))
        return
    done = "published" if report.published else "up to date:"
    click.echo(
        f"{done} {report.labels} {report.version} in {tables}: "
        f"{report.sentences_scored:,} sentences scored, {report.sentences_cached:,} cached, "
        f"{report.seconds:.1f} s"
    )


@click.command()
@tables_option
@labels_option
@format_option("table", "json")
@output_option
def status(tables: Path, labels: str, format_: str, output: Path | None) -> None:
    """Say what is published: model, label space, rows, size, age.

    \b
    Example:
      roomtables status --format json
    """
    version = SpaceFolder(tables, Path(labels).name).current()
    found = _describe(version)
    if format_ == "json":
        emit(as_json(found), output)
    else:
        rows = [{"what": key, "value": value} for key, value in found.items()]
        emit(render(rows, "table", ["what", "value"]), output)


def _describe(version: Version) -> dict[str, Any]:
    manifest = version.manifest
    model = manifest["model"]
    return {
        "labels": manifest["labels"],
        "version": version.name,
        "created": manifest["created"],
        "age_hours": round((datetime.now(UTC) - version.created).total_seconds() / 3600, 2),
        "scorer_id": manifest["scorer_id"],
        "query_scorer_id": manifest["query_scorer_id"],
        "model": model["model"],
        "strategy": model["described"].get("strategy"),
        "objects": manifest["objects"],
        "rooms": manifest["rooms"],
        "predicted_rooms": manifest["predicted_rooms"],
        "sources": list(manifest["combinations"]),
        "combinations": sum(manifest["combinations"].values()),
        "bytes": sum(path.stat().st_size for path in version.path.rglob("*") if path.is_file()),
    }
