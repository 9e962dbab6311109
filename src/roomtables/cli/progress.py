"""A progress bar on stderr, and lines of text above it; without tqdm, the lines alone."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, TypeVar

from roomtables.cli.printing import echo
from roomtables.progress import progress_bar

Item = TypeVar("Item")


def counted(items: Sequence[Item], what: str) -> Iterator[Item]:
    """The items, with a bar on a terminal where there are several; tqdm is of the extra `build`."""
    if len(items) < 2 or not sys.stderr.isatty():
        yield from items
        return
    try:
        bar = progress_bar(what, len(items), leave=False)
    except ModuleNotFoundError:
        yield from items
        return
    with bar:
        for item in items:
            yield item
            bar.update()


@contextmanager
def counted_bytes(what: str) -> Iterator[Callable[[int, int], None]]:
    """Called with the bytes just done and all there are to do: a bar on a terminal, with tqdm."""
    with ExitStack() as stack:
        bars: list[Any] = []

        def done(size: int, total: int) -> None:
            if not bars and sys.stderr.isatty():
                with suppress(ModuleNotFoundError):
                    bar = progress_bar(what, total, leave=False, unit_scale=True)
                    bars.append(stack.enter_context(bar))
            for bar in bars:
                bar.update(size)

        yield done


def write_line(text: str) -> None:
    """Print a line on stderr, above the bar where one is shown."""
    if "tqdm" not in sys.modules:
        echo(text, err=True)
        return
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)
