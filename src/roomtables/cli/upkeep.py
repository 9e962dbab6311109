"""Commands for tables that are rebuilt every night: status, gc, compact, rollback, diff."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.cli.completion import complete_versions
from roomtables.cli.printing import as_json, echo
from roomtables.errors import StoreError
from roomtables.storage.removal import KEPT_VERSIONS
from roomtables.storage.spaces import find_space
from roomtables.storage.versions import Version

_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days"}
_CLOCK_SKEW = timedelta(minutes=5)


def _age(ctx: click.Context, param: click.Parameter, value: str | None) -> timedelta | None:
    """A length of time such as ``90m``, ``26h`` or ``2d``."""
    if value is None:
        return None
    found = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?)([smhd])", value)
    if not found:
        raise click.BadParameter(f"{value!r} is not a length of time such as 90m, 26h or 2d")
    return timedelta(**{_UNITS[found[2]]: float(found[1])})


@click.command()
@tables_option
@labels_option
@click.option("--max-age", callback=_age, help="Exit 1 when older: 90m, 26h, 2d.")
@click.option("--verify", is_flag=True, help="Exit 1 when a published file is not as written.")
@format_option("table", "json")
@output_option
def status(
    tables: Path,
    labels: str | None,
    max_age: timedelta | None,
    verify: bool,
    format_: str,
    output: Path | None,
) -> None:
    """Say what is published: model, label space, rows, size, age.

    \b
    Example:
      roomtables status --format json
      roomtables status --max-age 26h --verify
    """
    version = find_space(tables, labels).current()
    if max_age is not None:
        _check_age(version, max_age)
    if verify:
        version.verify()
    found = _describe(version)
    if format_ == "json":
        emit(as_json(found), output)
    else:
        found["coverage"] = _in_words(found["coverage"])
        rows = [{"what": key, "value": value} for key, value in found.items()]
        emit(render(rows, "table", ["what", "value"]), output)


def _check_age(version: Version, max_age: timedelta) -> None:
    age = _age_of(version)
    if age < -_CLOCK_SKEW:
        raise StoreError(
            f"{version.path} is dated {version.manifest.created.isoformat()}, in the future; "
            "see what the clock says (`date -u`)"
        )
    if age > max_age:
        raise StoreError(
            f"{version.path} is {_hours(age)} h old, more than {_hours(max_age)} h; look into the "
            "log of the last build, or run `roomtables build`"
        )


def _age_of(version: Version) -> timedelta:
    return datetime.now(timezone.utc) - version.manifest.created


def _hours(age: timedelta) -> str:
    return f"{age.total_seconds() / 3600:.4g}"


def _describe(version: Version) -> dict[str, Any]:
    manifest = version.manifest
    return {
        "labels": manifest.labels,
        "version": version.name,
        "created": manifest.created.isoformat(),
        "age_hours": round(_age_of(version).total_seconds() / 3600, 2),
        "scorer_id": manifest.scorer_id,
        "query_scorer_id": manifest.query_scorer_id,
        "model": manifest.settings.model,
        "strategy": manifest.model.get("strategy"),
        "objects": manifest.objects,
        "rooms": manifest.rooms,
        "predicted_rooms": manifest.predicted_rooms,
        "sources": list(manifest.combinations),
        "combinations": sum(manifest.combinations.values()),
        "coverage": asdict(manifest.coverage),
        "bytes": sum(path.stat().st_size for path in version.path.rglob("*") if path.is_file()),
    }


def _in_words(coverage: Mapping[str, Any]) -> str:
    seconds = coverage["rest_seconds"]
    took = f", about {seconds:,.0f} s" if seconds else ""
    return (
        f"{coverage['held']:,} of {coverage['combinations']:,} combinations; "
        f"the rest: {coverage['rest_sentences']:,} sentences{took}"
    )


@click.command()
@tables_option
@click.option(
    "--keep",
    type=click.IntRange(min=1),
    default=KEPT_VERSIONS,
    show_default=True,
    help="Versions to keep of each label space.",
)
@click.option("--unused-scores", is_flag=True, help="Scores of models no version uses, too.")
@format_option()
@output_option
def gc(tables: Path, keep: int, unused_scores: bool, format_: str, output: Path | None) -> None:
    """Remove old versions, retired score parts, and what killed builds left behind.

    The published version stays, and so does whatever a reader holds open.

    \b
    Example:
      roomtables gc --keep 2
    """
    from roomtables.offline.upkeep import collect_garbage

    removed = collect_garbage(tables, keep, unused_scores)
    rows = [{"path": row.path, "what": row.what, "bytes": row.bytes} for row in removed]
    if format_ == "table" and not rows:
        emit("nothing to remove\n", output)
    else:
        emit(render(rows, format_, ["path", "what", "bytes"]), output)


@click.command()
@tables_option
@format_option()
@output_option
def compact(tables: Path, format_: str, output: Path | None) -> None:
    """Merge the score parts of each model into one file, each sentence once.

    Readers may go on reading; scores are shared by all label spaces.

    \b
    Example:
      roomtables compact
    """
    from roomtables.offline.upkeep import compact as merge

    columns = ("scorer_id", "parts_before", "parts_after", "bytes_before", "bytes_after")
    emit(render([done.as_json() for done in merge(tables)], format_, columns), output)


@click.command()
@tables_option
@labels_option
@format_option("table", "json")
def rollback(tables: Path, labels: str | None, format_: str) -> None:
    """Publish the version before the published one.

    \b
    Example:
      roomtables rollback --labels mpcat40
    """
    from roomtables.offline.upkeep import roll_back

    left, now = roll_back(tables, find_space(tables, labels).labels)
    if format_ == "json":
        emit(as_json({"labels": now.manifest.labels, "version": now.name, "left": left.name}))
    else:
        echo(f"published {now.name} of {now.path.parent}; {left.name} stays until `gc`")


@click.command()
@click.argument("before", required=False, shell_complete=complete_versions)
@click.argument("after", required=False, shell_complete=complete_versions)
@tables_option
@labels_option
@click.option("--top", type=click.IntRange(min=0), default=20, show_default=True, help="Objects.")
@format_option("table", "json")
@output_option
def diff(
    before: str | None,
    after: str | None,
    tables: Path,
    labels: str | None,
    top: int,
    format_: str,
    output: Path | None,
) -> None:
    """Say what changed between two versions: by default since the version before.

    Objects that now speak for another room come first, then those whose entropy moved most.

    \b
    Example:
      roomtables diff --top 10
      roomtables diff 000001-1f3c5a77 000004-9b2e0c1d
    """
    from roomtables.offline.diff import compare

    space = find_space(tables, labels)
    newer = space.named(after) if after else space.current()
    older = space.named(before) if before else space.before(newer)
    found = compare(older, newer)
    if format_ == "json":
        emit(as_json(found.as_json() | {"objects": found.objects[:top]}), output)
        return
    lines = [f"{found.labels}: {found.before} → {found.after}\n"]
    lines += [f"{name}: {was} → {now}\n" for name, (was, now) in found.settings.items()]
    lines += [
        f"{row['source']}: {row['held_in_both']:,} combinations in both, "
        f"{row['other_room']:,} of them with another best room; "
        f"{row['added']:,} added, {row['removed']:,} removed\n"
        for row in found.combinations
    ]
    moved = len(found.objects)
    lines.append(f"{moved} objects moved{f', the first {top}' if moved > top else ''}\n")
    if moved:
        lines.append(render(found.objects[:top], "table"))
    emit("".join(lines), output)
