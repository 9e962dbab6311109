"""Progress bars on stderr: labelled by what is counted, and legible in 80 columns."""

from __future__ import annotations

from typing import Any

# The bar has a width of its own: tqdm would give it what is left of the line, which may be nothing.
# What a narrow terminal has no room for is cut at the end.
_FORMAT = (
    "{desc}: {percentage:3.0f} %|{bar:16}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]{postfix}"
)


def progress_bar(
    what: str,
    total: int | None,
    *,
    shown: bool = True,
    leave: bool = True,
    unit_scale: bool = False,
) -> Any:
    """A tqdm bar for ``total`` items; unless ``shown`` it does nothing.

    ``leave``: it stays when it is closed. ``unit_scale``: counts are short, such as 1.2M.

    Raises
    ------
    ModuleNotFoundError
        tqdm, of the extra ``build``, is not installed.
    """
    from tqdm import tqdm

    return tqdm(
        total=total,
        desc=what,
        bar_format=_FORMAT,
        mininterval=0.5,
        leave=leave,
        disable=not shown,
        unit_scale=unit_scale,
    )
