"""SIGINT and SIGTERM: a command stops, tidies up, says one line, and exits with code 130."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

import click

INTERRUPTED = 130
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_came: list[int] = []  # signals, since the command began


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    _came.append(number)
    raise KeyboardInterrupt


@contextmanager
def interruptible() -> Iterator[None]:
    """Let a service manager's stop be as clean as Ctrl-C; a signal that is ignored stays so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _interrupt)
    _came.clear()
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def noticing_interrupts() -> Iterator[None]:
    """See that no signal is lost: Python drops what is raised in a finalizer, and a library may
    raise another exception in its place.

    Raises
    ------
    KeyboardInterrupt
        A signal came, however the block ended.
    """
    try:
        yield
    except Exception as error:
        if _came:
            raise KeyboardInterrupt from error
        raise
    if _came:
        raise KeyboardInterrupt


def end_interrupted(ctx: click.Context) -> NoReturn:
    """Say that a command was interrupted, and end it; a second signal comes too late."""
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    _came.clear()
    click.echo("interrupted; what is scored is kept", err=True)
    ctx.exit(INTERRUPTED)
