"""The command line: parse, call the package, print, choose an exit code."""

from __future__ import annotations

import click

from roomtables.cli.interrupts import leaving_at_once
from roomtables.memory import spare_address_space

spare_address_space()  # before numpy is imported, which starts OpenBLAS

with leaving_at_once():
    from roomtables.cli.common import Group
    from roomtables.cli.comparing import diff
    from roomtables.cli.evaluating import evaluate_command, report_command
    from roomtables.cli.exploring import sql_command
    from roomtables.cli.fleet import pull_command, push_command
    from roomtables.cli.labelling import classify
    from roomtables.cli.paper import paper_command
    from roomtables.cli.scenes import label, rooms, show
    from roomtables.cli.serving import serve
    from roomtables.cli.spaces import labels
    from roomtables.cli.tables import build_command, export_command, misses_command, plan_command
    from roomtables.cli.upkeep import compact, gc, rollback, status


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="roomtables")
def main() -> None:
    """Label rooms by the objects in them, with a language model's common sense in tables.

    \b
    Exit codes: 0 done; 1 something to correct (one line says what); 2 wrong usage.

    \b
    Example:
      roomtables build
      roomtables classify toilet sink towel
    """


for command in (
    build_command,
    classify,
    compact,
    diff,
    evaluate_command,
    export_command,
    gc,
    paper_command,
    report_command,
    label,
    labels,
    misses_command,
    plan_command,
    pull_command,
    push_command,
    rollback,
    rooms,
    serve,
    show,
    sql_command,
    status,
):
    main.add_command(command)
