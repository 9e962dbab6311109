"""How many weights a model's files hold, and whether the memory for them is free.

Neither torch nor transformers is imported here, unless a GPU is asked how much it has left.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path

from roomtables.errors import ModelError
from roomtables.limits import JSON_BYTES, MalformedError, json_value
from roomtables.lm.folders import ModelFolder
from roomtables.memory import free
from roomtables.scorer import DTYPES

LARGEST_IN_FLOAT32 = 1_500_000_000
"""Weights of the largest model in half precision that is checked in float32 once it is loaded."""

_BYTES = {"float64": 8, "float32": 4, "float16": 2, "bfloat16": 2}  # of a weight
_ENTRY_BYTES = (
    1024  # that package gguf and its caller take for each value of a list, such as tokens
)
_SAID_FROM = 100_000_000  # bytes: what smaller models need is not worth a line
_HEADER_BYTES = 8  # of a safetensors file, which say how long its header is

_log = logging.getLogger(__name__)
_log.setLevel(logging.INFO)  # what a large model needs is said before it is loaded


@dataclass(frozen=True)
class Weights:
    """What a model's files hold.

    Attributes
    ----------
    tensors : how many
    elements : of all tensors, at most
    largest : of the largest tensor
    """

    tensors: int
    elements: int
    largest: int


def held_by(folder: ModelFolder) -> Weights:
    """The weights of a model, by the headers of its files.

    Raises
    ------
    ModelError
        An index lists what is no safetensors file of the folder.
    """
    if folder.gguf:
        return Weights(folder.gguf.tensors, folder.gguf.elements, folder.gguf.largest)
    sizes = [size for path in folder.weight_files() for size in _sizes(path)]
    return Weights(len(sizes), sum(sizes), max(sizes, default=0))


def _sizes(path: Path) -> Iterator[int]:
    """Elements of each tensor in a safetensors file; none where its header cannot be read, since
    loading it says what is wrong."""
    whole = path.stat().st_size
    with path.open("rb") as file:
        length = int.from_bytes(file.read(_HEADER_BYTES), "little")
        header = file.read(min(length, JSON_BYTES))
    try:
        entries = json_value(header)
    except MalformedError:
        return
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        shape = entry.get("shape") if isinstance(entry, dict) else None
        if name != "__metadata__" and isinstance(shape, list):
            known = all(type(size) is int and size >= 0 for size in shape)
            yield min(prod(shape) if known else whole, whole)  # a byte at least for each element


def refuse_where_short(folder: ModelFolder, dtype: str, device: str) -> None:
    """Say what a large model needs and what is free, before it is loaded.

    A model is always loaded into main memory, and from there moved to a GPU.

    Raises
    ------
    ModelError
        The memory, or the GPU's, is too short for it; or the dtype is unknown.
    """
    if dtype not in DTYPES:
        raise ModelError(f"unknown dtype {dtype!r}; use one of {', '.join(DTYPES[:3])}")
    needed = {"memory": in_main_memory(folder, dtype, device)}
    left = {"memory": free()}
    if device == "cuda":
        import torch

        needed["GPU memory"] = held_by(folder).elements * _BYTES[dtype]
        left["GPU memory"] = torch.cuda.mem_get_info()[0]
    said = ", ".join(
        f"about {_gigabytes(needed[of])} GB of {of} ({_gigabytes(left[of])} GB free)"
        for of in needed
    )
    if any(needed[of] > left[of] for of in needed):
        smaller = "" if dtype not in ("float32", "float64") else "a smaller --dtype, "
        raise ModelError(
            f"no room for {folder.name} in {dtype}: it needs {said}; "
            f"try {smaller}a smaller --model, or another machine"
        )
    if needed["memory"] >= _SAID_FROM:
        _log.info("loading %s in %s: needs %s", folder.name, dtype, said)


def in_main_memory(folder: ModelFolder, dtype: str, device: str) -> int:
    """Bytes of main memory that loading a model takes at most, roughly.

    That is its weights, the largest of them twice in float32 while it is converted, for half
    precision on a CPU the weights in float32 during the self-check, and for a GGUF file what its
    lists of tokens take in Python.
    """
    weights, width = held_by(folder), _BYTES[dtype]
    if device == "cpu" and weights.elements <= LARGEST_IN_FLOAT32:
        width = max(width, _BYTES["float32"])
    entries = folder.gguf.entries if folder.gguf else 0
    conversion = 2 * weights.largest * _BYTES["float32"] if folder.gguf else 0
    return weights.elements * width + conversion + entries * _ENTRY_BYTES


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.1f}" if size >= 1e8 else f"{size / 1e9:.2g}"
