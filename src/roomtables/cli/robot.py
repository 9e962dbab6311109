"""Commands for a robot's tables: misses, export."""

from __future__ import annotations

from pathlib import Path

import click

from roomtables.cli.common import (
    emit,
    format_option,
    labels_option,
    output_option,
    render,
    tables_option,
)
from roomtables.misses import FOLDER, Misses
from roomtables.store import SpaceFolder

_COLUMNS = ("source", "objects", "times_asked", "last_asked")


@click.command("misses")
@tables_option
@labels_option
@format_option()
@output_option
def misses_command(tables: Path, labels: str, format_: str, output: Path | None) -> None:
    """List the combinations of known objects that were asked for and that no table held.

    `build --combinations misses` puts them into the tables; then they are listed no more.

    \b
    Example:
      roomtables misses --format csv
    """
    space = SpaceFolder(tables, Path(labels).name)
    if not space.path.is_dir():
        space.current()  # says what is missing, and what there is
    rows = [
        miss._asdict() | {"objects": list(miss.objects), "last_asked": miss.last_asked.isoformat()}
        for miss in Misses.read(space.path / FOLDER).open
    ]
    emit(render(rows, format_, _COLUMNS), output)
