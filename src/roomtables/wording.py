"""How numbers are written for people; JSON and CSV hold them as they are."""

from __future__ import annotations

from collections.abc import Mapping


def percent(share: float, places: int = 1, *, signed: bool = False) -> str:
    """A share from 0 to 1 (an accuracy, a coverage) in percent: ``0.7767`` → ``77.7 %``.

    ``signed`` puts a plus before what is not negative: a difference of two shares.
    """
    return f"{100 * share:{'+' if signed else ''}.{places}f} %"


def counts(numbers: Mapping[str, int]) -> str:
    """Counts on one line, sorted by what they are of: ``lm 3, table 520``."""
    return ", ".join(f"{what} {n}" for what, n in sorted(numbers.items()) if n) or "none"
