"""The command that compares two versions of the tables: diff."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

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
from roomtables.cli.printing import as_json
from roomtables.cli.wrapping import wrapped
from roomtables.storage.spaces import find_space

if TYPE_CHECKING:
    from roomtables.offline.diff import Diff

_ENTROPIES = ("entropy_before", "entropy_after")
_ROOMS = ("first_room_before", "first_room_after")
# So that it all fits into 80 columns.
_LINE_WIDTH, _CAUSE_WIDTH, _NAME_WIDTH = 80, 34, 23


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
    emit(_diff_text(found, top), output)


def _diff_text(found: Diff, top: int) -> str:
    """A comparison as a person reads it: why, how much, and the objects that moved most."""
    causes = "; ".join(found.causes) or "no setting, input or model"
    lines = [
        f"{found.labels}: {found.before} → {found.after}",
        *wrap(f"changed: {causes}", _LINE_WIDTH),
    ]
    if found.nothing_moved:
        return "\n".join([*lines, "nothing moved\n"])
    for row in found.combinations:
        said = (
            f"{row['source']}: {row['held_in_both']:,} combinations in both, "
            f"{row['other_room']:,} of them with another best room; "
            f"{row['added']:,} added, {row['removed']:,} removed"
        )
        lines += wrap(said, _LINE_WIDTH, subsequent_indent="  ")
    moved = len(found.objects)
    if not moved:
        return "\n".join([*lines, "0 objects moved\n"])
    groups = [
        {
            "source": group["source"],
            "moved because": group["cause"],
            "objects": f"{group['objects']:,}",
            "other room": f"{group['other_first_room']:,}",
            "nats": f"{group['largest_entropy_change']:.4g}",
        }
        for group in found.groups
    ]
    lines += ["", render(wrapped(groups, {"moved because": _CAUSE_WIDTH}), "table")]
    first = f", the first {top}" if moved > top else ""
    lines.append(f"{moved:,} object{'s' if moved > 1 else ''} moved{first}\n")
    rows = [_moved_row(row) for row in found.objects[:top]]
    widths = {"object": _NAME_WIDTH, "first room": _NAME_WIDTH}
    return "\n".join(lines) + (render(wrapped(rows, widths), "table") if rows else "")


def _moved_row(row: Mapping[str, Any]) -> dict[str, str]:
    """An object that moved: its entropy and first room, before and after where they differ."""
    entropies = ["-" if row[name] is None else f"{row[name]:.4f}" for name in _ENTROPIES]
    rooms = [row[name] or "-" for name in _ROOMS]
    return {
        "source": row["source"],
        "object": row["object"],
        "entropy (nats)": " → ".join(dict.fromkeys(entropies)),
        "first room": " → ".join(dict.fromkeys(rooms)),
    }
