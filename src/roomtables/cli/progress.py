"""A progress bar on stderr, and lines of text above it; without tqdm, the lines alone."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TypeVar

from roomtables.cli.printing import echo

Item = TypeVar("Item")


def progress_bar(items: Sequence[Item], unit: str) -> Iterable[Item]:
    """The items, with a bar on a terminal where there are several; tqdm is of the extra `build`."""
    if len(items) < 2 or not sys.stderr.isatty():
        return items
    try:
        from tqdm import tqdm
    except ModuleNotFoundError:
        return items
    bar: Iterable[Item] = tqdm(items, unit=unit, leave=False)
    return bar


def write_line(text: str) -> None:
    """Print a line on stderr, above the bar where one is shown."""
    if "tqdm" not in sys.modules:
        echo(text, err=True)
        return
    from tqdm import tqdm

    tqdm.write(text, file=sys.stderr)
