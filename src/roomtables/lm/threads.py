"""How many threads a model is run with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

# Below this many parameters a matrix product is shorter than the wait for a second thread: one
# thread is as fast on an idle machine, and over ten times as fast where another process is busy.
_WORTH_SHARING = 20_000_000


def threads_for(parameters: int, device: str) -> int:
    """Threads for a model of this size: the same on every run, so that scores are too."""
    return 1 if device == "cpu" and parameters < _WORTH_SHARING else torch.get_num_threads()


@contextmanager
def using_threads(count: int) -> Iterator[None]:
    """Run torch with ``count`` threads for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
