"""Commands that take tables to a place and from there to robots: push, pull."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path

import click

from roomtables.cli.common import emit, format_option, labels_option, tables_option
from roomtables.cli.printing import as_json, echo
from roomtables.cli.progress import counted_bytes
from roomtables.online.classifier import RoomTables
from roomtables.storage.export import WriteModel
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import SENT_NOTE, Misses
from roomtables.storage.places import shown
from roomtables.storage.pulling import pull
from roomtables.storage.pushing import KEPT_THERE, push
from roomtables.storage.sent_misses import send_misses
from roomtables.storage.spaces import find_space


@click.command("push")
@click.argument("url")
@click.option("--all", "all_files", is_flag=True, help="The Parquet tables, too.")
@click.option("--with-model", is_flag=True, help="The model, too, in ONNX.")
@click.option("--misses", is_flag=True, help="What was asked for here in vain, instead of tables.")
@click.option(
    "--keep",
    type=click.IntRange(min=1),
    default=KEPT_THERE,
    show_default=True,
    help="Versions to keep at the place.",
)
@tables_option
@labels_option
@format_option("table", "json")
def push_command(
    url: str,
    all_files: bool,
    with_model: bool,
    misses: bool,
    keep: int,
    tables: Path,
    labels: str | None,
    format_: str,
) -> None:
    """Send the published tables to a place, such as s3://bucket/tables or file:///mnt/tables.

    Only what is not there is sent; the place's pointer moves last. With --misses a robot sends home
    which combinations no table held; `build --misses-from` takes them in.

    \b
    Example:
      roomtables push s3://bucket/tables
      roomtables push s3://bucket/tables --misses
    """
    space = find_space(tables, labels).labels
    if misses and (all_files or with_model):
        raise click.UsageError("--misses sends no tables: leave out --all and --with-model")
    if misses:
        _push_misses(url, tables, space, format_)
        return
    started = time.monotonic()
    with counted_bytes("pushing") as progress:
        done = push(
            tables,
            space,
            url,
            all_files=all_files,
            write_model=_robot_model() if with_model else None,
            keep=keep,
            progress=progress,
        )
    seconds = time.monotonic() - started
    if format_ == "json":
        emit(as_json(asdict(done) | {"seconds": round(seconds, 3)}))
        return
    what = "pushed" if done.moved or done.files else "nothing new:"
    echo(
        f"{what} {done.labels} {done.version} to {shown(url)}: {done.files} files, "
        f"{_size(done.bytes)} sent, {done.removed} old versions removed, {seconds:.1f} s"
    )


def _robot_model() -> WriteModel:
    from roomtables.offline.robot_model import write_robot_model

    return write_robot_model


def _push_misses(url: str, tables: Path, labels: str, format_: str) -> None:
    done = send_misses(tables, labels, url)
    if format_ == "json":
        emit(as_json(done._asdict()))
    elif done.combinations:
        echo(
            f"pushed {done.combinations:,} misses of {labels} to {shown(url)}: {done.files} files, "
            f"{_size(done.bytes)} sent"
        )
    else:
        echo(f"nothing new: no misses of {labels} since the last push to {shown(url)}")


@click.command("pull")
@click.argument("url")
@tables_option
@labels_option
@format_option("table", "json")
def pull_command(url: str, tables: Path, labels: str | None, format_: str) -> None:
    """Fetch the tables that a place publishes, verify every byte, and publish them here.

    \b
    Example:
      roomtables pull s3://bucket/tables
    """
    started = time.monotonic()
    space = find_space(tables, labels).labels
    with counted_bytes("pulling") as progress:
        done = pull(tables, space, url, progress)
    answered, asked = _answered(tables, space) if done.new else (0, 0)
    seconds = time.monotonic() - started
    if format_ == "json":
        counted = {"misses": asked, "misses_answered": answered} if done.new else {}
        emit(as_json(asdict(done) | counted | {"seconds": round(seconds, 3)}))
    elif done.new:
        echo(
            f"pulled {done.labels} {done.version} from {shown(url)}: {done.files} files, "
            f"{_size(done.bytes_fetched)} fetched, {_size(done.bytes_here)} already here, "
            f"{seconds:.1f} s"
        )
        if asked:
            echo(f"of {asked:,} combinations asked for here in vain, {answered:,} are answered now")
    else:
        echo(f"nothing new: {done.labels} {done.version} from {shown(url)}, {seconds:.1f} s")


def _answered(tables: Path, labels: str) -> tuple[int, int]:
    """How many of the combinations that were asked for here in vain the tables hold now; of all."""
    misses = Misses.read(tables / labels / FOLDER, SENT_NOTE)
    asked = misses.taken | {(miss.source, miss.objects) for miss in misses.open}
    opened = RoomTables.open(tables, labels, offline=True, note_misses=False)
    answered = 0
    for source in {source for source, _ in asked} & {*opened.lookup.sources}:
        rooms = [objects for of, objects in asked if of == source]
        deciding = opened.deciding(rule="query", source=source, backoff=False)
        answered += sum(found.answered_by == "table" for found in deciding.classify_many(rooms))
    return answered, len(asked)


def _size(size: int) -> str:
    return f"{size / 1e6:,.1f} MB" if size >= 1e6 else f"{size / 1e3:,.0f} kB"
