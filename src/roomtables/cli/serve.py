"""The command that labels a running robot's rooms: serve."""

from __future__ import annotations

import gc
import logging
import signal
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    Namer,
    decision_options,
    labels_option,
    labelspace_option,
    tables_option,
)
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.online.serve import Labeller, Service
from roomtables.scenes.sparkdsg import GraphCodec, LiveGraph


@click.command()
@click.option(
    "--recv",
    default="tcp://127.0.0.1:8001",
    show_default=True,
    help="Where graphs come from: Hydra's ZmqSink.",
)
@click.option(
    "--send",
    default="tcp://127.0.0.1:8002",
    show_default=True,
    help="Where labelled graphs are published: Hydra's ZmqRoomLabelUpdater listens there.",
)
@click.option(
    "--report-every",
    type=click.FloatRange(min=0.1),
    default=10.0,
    show_default=True,
    help="Seconds between two lines of counters on stderr.",
)
@tables_option
@labels_option
@labelspace_option
@decision_options
def serve(
    recv: str,
    send: str,
    report_every: float,
    tables: Path,
    labels: str,
    labelspace: Path | None,
    offline: bool,
    **decision: Any,
) -> None:
    """Label a running Hydra's rooms as they change, until interrupted.

    What no table holds is answered by pooled evidence at once, and by the language model a little
    later, unless --offline forbids it.

    \b
    Example:
      roomtables serve --labelspace ade20k_mp3d_label_space.yaml
    """
    logging.addLevelName(logging.INFO, "info")
    logging.getLogger("roomtables").setLevel(logging.INFO)
    opened = RoomTables.open(tables, labels, offline=True, **decision)
    asking = None if offline else RoomTables.open(tables, labels, **decision)
    candidates, namer = [room.label for room in opened.candidates], Namer(opened)

    def name(graph: LiveGraph, answers: Mapping[str, Prediction]) -> None:
        graph.name_rooms(namer(answers), candidates)

    service = Service(GraphCodec(labelspace), Labeller(opened, asking), name, recv, send)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    click.echo(f"labelling rooms of {recv}, publishing on {send}; Ctrl-C ends it", err=True)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; to look it over again would hold graphs up
    try:
        service.run(stop, report_every)
    finally:
        service.close()
        gc.unfreeze()
    click.echo(f"stopped: {service.counters.line()}", err=True)
