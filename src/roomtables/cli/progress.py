"""A progress bar on stderr, and lines of text above it; without tqdm, the lines alone."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TypeVar

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


def write_line(text: str) -> None:
    """Print a line on stderr, above the bar where one is shown."""
    if "tqdm" not in sys.modules:
        echo(text, err=True)
        return
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)
