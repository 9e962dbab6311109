"""Whether torch fits under `ulimit -v`, found out before it is imported: it crashes where not."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from roomtables.errors import ModelError
from roomtables.memory import MEGABYTE, address_space_limit, shortage

# Megabytes that torch, transformers and a small model map beside torch's libraries.
_BESIDE_LIBRARIES = 320


def check_address_space() -> None:
    """Refuse to import torch where its libraries and a small model do not fit.

    Raises
    ------
    ModelError
        The limit on address space is too low; the message says which one is enough.
    """
    if address_space_limit() is None or "torch" in sys.modules:
        return
    found = find_spec("torch")
    places = (found.submodule_search_locations if found else None) or []
    libraries = [path for place in places for path in Path(place).glob("lib/*.so*")]
    size = sum(path.stat().st_size for path in libraries) // MEGABYTE
    short = shortage("a language model", size + _BESIDE_LIBRARIES) if libraries else None
    if short:
        raise ModelError(short)
