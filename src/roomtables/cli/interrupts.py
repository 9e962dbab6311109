"""SIGINT and SIGTERM: a command stops, tidies up, says one line, and exits with code 130."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
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


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


@contextmanager
def leaving_at_once() -> Iterator[None]:
    """While the program is imported and has changed nothing, end it at a signal, in one line."""
    with _handled_by(_leave):
        yield


@contextmanager
def interruptible() -> Iterator[None]:
    """Let a service manager's stop be as clean as Ctrl-C; a signal that is ignored stays so."""
    _came.clear()
    with _handled_by(_interrupt):
        yield


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], NoReturn]) -> Iterator[None]:
    """Handle the signals that nobody ignores or handles; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    for number, standing in before.items():
        if standing in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, handler)
    try:
        yield
    finally:
        for number, standing in before.items():
            signal.signal(number, standing)


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
    exec("")  # or Python dies of SIGINT at its end if that came within an `exec`
    click.echo("interrupted; what is scored is kept", err=True)
    ctx.exit(INTERRUPTED)
