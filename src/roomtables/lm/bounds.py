"""What a model's configuration may ask for: no more than its weights can fill.

A configuration is data from outside: ``n_layer`` of 10³⁰ would have torch build modules until
memory ends. Counts are bounded before transformers reads them, and what torch builds is counted
while it is built.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torch.nn.modules import module as torch_module

from roomtables.errors import ModelError
from roomtables.limits import JSON_BYTES, MalformedError, json_value
from roomtables.lm.folders import ModelFolder

MOST_COUNT = 10_000
"""Of layers, heads, experts, labels: ten times what the largest models have."""
_COUNTS = re.compile(r"num_.*|.*layers?|.*_num")
_MODULES_A_TENSOR = 20  # dropouts, activations and containers hold none
_SPARE_MODULES = 1_000
_TIMES = 8  # a tensor is registered anew when it is loaded, tied or moved
_SPARE_ELEMENTS = 1 << 22
_HEADER_BYTES = 8  # of a safetensors file, which say how long its header is


def refuse_counts(folder: ModelFolder) -> None:
    """Refuse counts in ``config.json``, at any depth, that no model has.

    Raises
    ------
    ModelError
        One is beyond ``MOST_COUNT``.
    """
    for key, value in _numbers(folder.config):
        if _COUNTS.fullmatch(key) and abs(value) > MOST_COUNT:
            raise ModelError(
                f"{folder.name}: config.json asks for a `{key[:40]}` of more than {MOST_COUNT}; "
                "fetch the model again, or use another --model"
            )


def _numbers(value: Any) -> Iterator[tuple[str, float]]:
    """Every number in a JSON value that is an object's, with its key."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if isinstance(inner, int | float):
                yield key, inner
            yield from _numbers(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _numbers(inner)


@contextmanager
def bounded_by_weights(folder: ModelFolder) -> Iterator[None]:
    """Stop torch from building a network that is far larger than the folder's weights.

    Raises
    ------
    ModelError
        More modules or elements are built than the weights can fill.
    """
    tensors, elements = _held(folder.weight_files())
    left = {
        "modules": _SPARE_MODULES + _MODULES_A_TENSOR * tensors,
        "elements": _SPARE_ELEMENTS + _TIMES * elements,
    }

    def take(what: str, number: int) -> None:
        left[what] -= number
        if left[what] < 0:
            raise ModelError(
                f"{folder.name}: config.json asks for a larger network than its weights "
                f"({tensors} tensors) can fill; fetch the model again, or use another --model"
            )

    def parameter(module: Any, name: str, tensor: Any) -> None:
        take("elements", 0 if tensor is None else tensor.numel())

    hooks = [
        torch_module.register_module_module_registration_hook(lambda *_: take("modules", 1)),
        torch_module.register_module_parameter_registration_hook(parameter),
    ]
    try:
        yield
    finally:
        for hook in hooks:
            hook.remove()


def _held(files: list[Path]) -> tuple[int, int]:
    """How many tensors some safetensors files hold, and at most how many elements."""
    tensors = elements = 0
    for path in files:
        with path.open("rb") as file:
            length = int.from_bytes(file.read(_HEADER_BYTES), "little")
            header = file.read(min(length, JSON_BYTES))
        try:
            tensors += len(json_value(header))
        except (MalformedError, TypeError):
            continue  # loading it says what is wrong with the file
        elements += path.stat().st_size  # a byte at least for each
    return tensors, elements
