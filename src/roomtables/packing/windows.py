"""Sentences, and where the scored part of each begins, in windows of bounded size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, repeat

Asked = tuple[str, int | None]
"""A sentence, and the character from which its tokens count (``None``: all tokens count)."""


def windows(
    sentences: Iterable[str], starts: Iterable[int] | None, size: int
) -> Iterator[list[Asked]]:
    """Lists of at most ``size`` sentences with their starts, in order, read as they are needed.

    Raises
    ------
    ValueError
        There are not as many starts as sentences.
    """
    pairs = zip(sentences, repeat(None)) if starts is None else zip(sentences, starts, strict=True)
    while window := list(islice(pairs, size)):
        yield window


def unzipped(asked: Sequence[Asked]) -> tuple[list[str], list[int] | None]:
    """Sentences, and their starts (``None``: all tokens of all of them count)."""
    starts = [start for _, start in asked if start is not None]
    return [sentence for sentence, _ in asked], starts or None
