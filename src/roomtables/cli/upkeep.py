"""Commands for tables that are rebuilt every night: status, gc, compact, rollback."""

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
from roomtables.cli.printing import as_json, echo
from roomtables.cli.rebuilding import build_command
from roomtables.errors import StoreError
from roomtables.schemas import SENTENCE
from roomtables.sentences import DEFAULT_TEMPLATE
from roomtables.storage.checked import last_checked
from roomtables.storage.origin import origin_of
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
    checked = last_checked(version)
    if max_age is not None:
        _check_age(tables, version, checked, max_age)
    if verify:
        version.verify()
    found = _describe(version, checked)
    emit(as_json(found) if format_ == "json" else _status_text(version, found), output)


def _check_age(
    tables: Path, version: Version, checked: datetime | None, max_age: timedelta
) -> None:
    """Refuse tables that no build has published or found up to date for so long."""
    last = max(version.manifest.created, checked or version.manifest.created)
    age = _age_of(last)
    if age < -_CLOCK_SKEW:
        raise StoreError(
            f"{version.path} is dated {last.isoformat()}, in the future; "
            "see what the clock says (`date -u`)"
        )
    if age > max_age:
        raise StoreError(
            f"no build has published {version.path} or found it up to date for {_hours(age)} h, "
            f"more than {_hours(max_age)} h; see the log of the timer that should, or run "
            f"`{build_command(tables, version.manifest)}`"
        )


def _age_of(moment: datetime) -> timedelta:
    return datetime.now(timezone.utc) - moment


def _hours(age: timedelta) -> str:
    return f"{age.total_seconds() / 3600:.4g}"


def _describe(version: Version, checked: datetime | None) -> dict[str, Any]:
    manifest = version.manifest
    asked = manifest.extends_tables or any(manifest.combinations.values())
    origin = origin_of(version)
    return {
        "labels": manifest.labels,
        "version": version.name,
        "created": manifest.created.isoformat(),
        "checked": checked.isoformat() if checked else None,
        "pulled_from": origin.url if origin else None,
        "pulled": origin.moment.isoformat() if origin else None,
        "age_hours": round(_age_of(manifest.created).total_seconds() / 3600, 2),
        "scorer_id": manifest.scorer_id,
        "scores": str(manifest.settings.scores) if manifest.settings.scores else None,
        "query_scorer_id": manifest.query_scorer_id,
        "template": list(manifest.settings.template),
        "scored": manifest.settings.scored,
        "model": manifest.settings.model if manifest.query_scorer_id and asked else None,
        "strategy": manifest.model.get("strategy"),
        "objects": manifest.objects,
        "rooms": manifest.rooms,
        "predicted_rooms": manifest.predicted_rooms,
        "sources": list(manifest.combinations),
        "combinations": sum(manifest.combinations.values()),
        "coverage": asdict(manifest.coverage),
        "bytes": sum(path.stat().st_size for path in version.path.rglob("*") if path.is_file()),
    }


def _status_text(version: Version, found: Mapping[str, Any]) -> str:
    """What is published, as a person reads it."""
    manifest = version.manifest
    said = dict(found) | {"coverage": _in_words(found["coverage"])}
    if manifest.settings.scores:
        said["scorer_id"] = f"{manifest.scorer_id}: from the file of scores"
    if manifest.query_scorer_id and not any(manifest.combinations.values()):
        said["query_scorer_id"] = f"{manifest.query_scorer_id}: no query sentence is scored yet"
    templates = " | ".join(found["template"])
    said["template"] = None if templates == DEFAULT_TEMPLATE else templates
    said["scored"] = None if found["scored"] == SENTENCE else found["scored"]
    said["checked"] = found["checked"] or "not since it was published"
    said["sources"] = ", ".join(found["sources"])
    rows = [{"what": key, "value": value} for key, value in said.items() if value is not None]
    return render(rows, "table", ["what", "value"])


def _in_words(coverage: Mapping[str, Any]) -> str:
    seconds = coverage["rest_seconds"]
    took = f", about {seconds:,.0f} s" if seconds else ""
    return (
        f"{coverage['held']:,} of {coverage['combinations']:,} combinations are held; "
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
