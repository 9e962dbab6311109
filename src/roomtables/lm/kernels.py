"""Faster float32 arithmetic on a CPU, for the modules that cost most; the same mathematics.

torch's default matrix product in float32 (MKL) is slower than oneDNN's on many processors, by half
for a large output head, and transformers composes GPT-2's activation of eight passes over memory.
Each replacement is tried on the module's own weights first, and left out where it is absent or
disagrees.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional
from transformers.activations import NewGELUActivation
from transformers.pytorch_utils import Conv1D

_TOLERANCE = 1e-4


@torch.inference_mode()
def accelerate(model: Any) -> None:
    """Replace the forward of ``model``'s float32 linear maps and activations on a CPU, in place."""
    if model.device.type != "cpu" or model.dtype != torch.float32:
        return
    for module in model.modules():
        if type(module) is NewGELUActivation:
            module.forward = partial(functional.gelu, approximate="tanh")
        elif type(module) is torch.nn.Linear:
            _replace(module, module.weight, module.in_features)
        elif type(module) is Conv1D:
            # Stored (in, out); laid out as (out, in) beneath, it is the weight of a linear map.
            module.weight.data = module.weight.data.t().contiguous().t()
            _replace(module, module.weight.t(), module.nx)


def _replace(module: Any, weight: Tensor, inputs: int) -> None:
    probe = torch.linspace(-1, 1, 2 * inputs).reshape(1, 2, inputs)
    try:
        product: Callable[..., Tensor] = torch.ops.mkldnn._linear_pointwise
        fast = product(probe, weight, module.bias, "none", [], "")
    except (AttributeError, NotImplementedError, RuntimeError):
        return
    if torch.allclose(fast, module(probe), atol=_TOLERANCE, rtol=_TOLERANCE):
        module.forward = lambda hidden: product(hidden, weight, module.bias, "none", [], "")
