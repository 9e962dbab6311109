"""Warnings of a service that runs for days: at most one a kind and second."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

log = logging.getLogger(__name__)

_SECONDS = 1.0  # between two warnings of a kind
_MOST_KINDS = 50  # what comes after these is of one kind
_WORDS = 3  # the first words of a reason tell its kind; the rest may come from outside
_LONGEST = 300  # characters


@dataclass(slots=True)
class _Kind:
    told: float
    untold: int = 0


class Complaints:
    """Logs warnings, of each kind at most one a second; the next one says how many were not told.

    Of one kind are warnings whose reasons begin with the same words, numbers aside.

    Parameters
    ----------
    clock : seconds, from any start
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kinds: dict[str, _Kind] = {}

    def __call__(self, reason: str, warning: str = "{}") -> None:
        """Log a warning about a reason, unless one of its kind was logged within a second."""
        now, kind = self._clock(), self._kind(reason)
        known = self._kinds.get(kind)
        if known is not None and now - known.told < _SECONDS:
            known.untold += 1
            return
        more = f" (and {known.untold} more like it)" if known is not None and known.untold else ""
        self._kinds[kind] = _Kind(now)
        log.warning("%s%s", warning.format(shortened(reason)), more)

    def _kind(self, reason: str) -> str:
        kind = " ".join(re.sub(r"\d+", "", reason[:_LONGEST]).split()[:_WORDS])
        return kind if kind in self._kinds or len(self._kinds) < _MOST_KINDS else "others"


def shortened(text: str, longest: int = _LONGEST) -> str:
    """Text from outside, cut where it is too long for a line of a log."""
    return text if len(text) <= longest else text[:longest] + "…"
