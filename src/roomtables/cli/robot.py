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
from roomtables.storage.misses import FOLDER, Misses
from roomtables.storage.versions import SpaceFolder

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


@click.command("export")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("tables.tar.zst"),
    show_default=True,
    help="The archive: .tar.zst, .tar.gz or .tar.",
)
@tables_option
@labels_option
def export_command(output: Path, tables: Path, labels: str) -> None:
    """Pack the published tables for a robot: what a lookup needs, in one archive.

    \b
    Example:
      roomtables export -o tables.tar.zst --labels mpcat40
      tar --zstd -xf tables.tar.zst        # on the robot
    """
    from roomtables.storage.export import export

    for found in export(tables, Path(labels).name, output):
        click.echo(
            f"{found.source}: {found.combinations:,} combinations x {found.rooms} rooms, "
            f"{_megabytes(found.bytes)} unpacked"
        )
    click.echo(f"{output}: {_megabytes(output.stat().st_size)}")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.2f} MB"
