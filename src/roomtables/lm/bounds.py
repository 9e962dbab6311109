"""What a model's configuration may ask for: no more than its weights can fill.

A configuration is data from outside: ``n_layer`` of 10³⁰ would have torch build modules until
memory ends. Counts are bounded before transformers reads them, and what torch builds is counted
while it is built.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from torch.nn.modules import module as torch_module

from roomtables.errors import ModelError
from roomtables.lm.folders import ModelFolder
from roomtables.lm.gguf import MOST_COUNT
from roomtables.lm.weights import held_by

_COUNTS = re.compile(r"num_.*|.*layers?|.*_num")
_MODULES_A_TENSOR = 20  # dropouts, activations and containers hold none
_SPARE_MODULES = 1_000
_TIMES = 8  # a tensor is registered anew when it is loaded, tied or moved
_SPARE_ELEMENTS = 1 << 22


def _configuration(folder: ModelFolder) -> str:
    """Where the model's configuration stands."""
    return "its metadata" if folder.gguf else "config.json"


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
    held = held_by(folder)
    left = {
        "modules": _SPARE_MODULES + _MODULES_A_TENSOR * held.tensors,
        "elements": _SPARE_ELEMENTS + _TIMES * held.elements,
    }

    def take(what: str, number: int) -> None:
        left[what] -= number
        if left[what] < 0:
            raise ModelError(
                f"{folder.name}: {_configuration(folder)} asks for a larger network than its "
                f"weights ({held.tensors} tensors) can fill; fetch the model again, or use another "
                "--model"
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
