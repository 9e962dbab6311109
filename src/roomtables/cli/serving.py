"""The command that labels the rooms of a running robot: serve."""

from __future__ import annotations

import gc
import logging
import signal
import threading
from pathlib import Path
from typing import Any

import click

from roomtables.cli.common import (
    decision_options,
    labels_option,
    labelspace_option,
    tables_option,
)
from roomtables.cli.naming import keep_names_option, room_namer
from roomtables.cli.printing import echo
from roomtables.online.classifier import RoomTables
from roomtables.online.labeller import Labeller
from roomtables.online.live import GraphLabeller
from roomtables.online.model_thread import ModelThread
from roomtables.online.serve import Service
from roomtables.online.steady_names import DEFAULT_HOLD, DEFAULT_MARGIN, SteadyNames
from roomtables.scenes.live import GraphCodec


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
@keep_names_option
@click.option(
    "--margin",
    metavar="NATS",
    type=click.FloatRange(min=0),
    default=DEFAULT_MARGIN,
    show_default=True,
    help="By how much another name must lead a room's present one to replace it at once.",
)
@click.option(
    "--hold",
    metavar="N",
    type=click.IntRange(min=1),
    default=DEFAULT_HOLD,
    show_default=True,
    help="In how many updates in a row it must be best to replace it otherwise.",
)
@tables_option
@labels_option
@labelspace_option
@decision_options
def serve(
    recv: str,
    send: str,
    report_every: float,
    keep_names: bool,
    margin: float,
    hold: int,
    tables: Path,
    labels: str | None,
    labelspace: Path | None,
    offline: bool,
    **decision: Any,
) -> None:
    """Label a running Hydra's rooms as they change, until interrupted.

    What no table holds is answered by pooled evidence at once, and by the language model a little
    later, unless --offline forbids it. --margin 0 --hold 1 lets names follow every change.

    \b
    Example:
      roomtables serve --labelspace ade20k_mp3d_label_space.yaml
    """
    logging.addLevelName(logging.INFO, "info")
    logging.getLogger("roomtables").setLevel(logging.INFO)
    opened = RoomTables.open(tables, labels, offline=True, **decision)
    model = None
    if not offline:  # misses are noted once, by the tables that are asked first
        model = ModelThread(RoomTables.open(tables, labels, note_misses=False, **decision))
    names = SteadyNames(margin, hold, keep_names)
    labeller = Labeller(opened, model, lambda name: opened.names.nearest(name, 1))
    graphs = GraphLabeller(GraphCodec(labelspace), labeller, names, room_namer(opened))
    service = Service(graphs, recv, send)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    echo(f"labelling rooms of {recv}, publishing on {send}; Ctrl-C ends it", err=True)
    gc.collect()
    gc.freeze()  # what is loaded by now stays; to look it over again would hold graphs up
    try:
        service.run(stop, report_every)
    finally:
        service.close()
        gc.unfreeze()
    echo(f"stopped: {graphs.report()}", err=True)
