"""What is checked before a command runs: that its arguments are text, and that it fits."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

from roomtables.errors import InputError, StoreError
from roomtables.memory import shortage

# Megabytes of address space that duckdb and pyarrow need: of those commands that load them.
_WITH_DATABASE = 350
_NEEDED = {
    **dict.fromkeys(
        ("build", "compact", "diff", "gc", "paper", "plan", "report", "sql"), _WITH_DATABASE
    ),
    "export": 200,  # pyarrow alone, which compresses
}


def check_room(command: str) -> None:
    """Refuse a command that could only end in a crash under `ulimit -v`.

    Raises
    ------
    StoreError
        What it loads does not fit.
    """
    short = shortage(f"`roomtables {command}`", _NEEDED.get(command, 0))
    if short:
        raise StoreError(short)


def check_arguments(arguments: Iterable[str]) -> None:
    """Refuse arguments that are no text, unless they name a file.

    Raises
    ------
    InputError
        An argument's bytes are not UTF-8: no label, no query and no new file is called so.
    """
    for argument in arguments:
        value = argument.partition("=")[2] if argument.startswith("--") else argument
        if re.search("[\ud800-\udfff]", argument) and not os.path.lexists(value):
            raise InputError(f"argument {argument} is not UTF-8 text; give it in UTF-8")
