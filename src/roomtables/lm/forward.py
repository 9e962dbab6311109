"""One model's forward pass, read only at chosen positions.

A hook on the model's body keeps only the hidden states of those positions, so that the output
head, up to two fifths of the work, runs on nothing else. The model's own ``forward`` still applies
the head, with whatever soft-capping or scaling it has. Where a model has no separate body, its full
logits are computed and the positions read from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from roomtables.packing.sequences import FloatArray
from roomtables.packing.tokens import IntArray

# Elements of a block of logits: small enough for a CPU's cache, large enough for a GPU's launch.
_BLOCK = {"cpu": 1 << 20, "cuda": 1 << 26}


class Forward:
    """Runs a transformers ``model`` without gradients; log probabilities are in nats, float64."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self.device = torch.device(model.device)
        self._positions: Tensor | None = None
        if model.base_model is not model:
            model.base_model.register_forward_hook(self._keep_read)

    @property
    def dtype(self) -> torch.dtype:
        """What the model computes in."""
        dtype: torch.dtype = self.model.dtype
        return dtype

    def tensor(self, array: npt.NDArray[Any]) -> Tensor:
        """The array on the model's device, same shape and dtype."""
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device, non_blocking=True)

    @torch.inference_mode()
    def sequence(self, tokens: list[int]) -> FloatArray:
        """Log probability of each token but the first given those before it, ``[tokens - 1]``.

        One plain forward of the model: the reference for what :meth:`read` gives.
        """
        ids = torch.tensor([tokens], device=self.device)
        logits = _at_least_float32(self.model(input_ids=ids).logits[0, :-1])
        chosen = torch.log_softmax(logits, -1).gather(1, ids[0, 1:, None])[:, 0]
        return chosen.double().cpu().numpy()

    @torch.inference_mode()
    def masked(self, tokens: list[int], position: int, token: int) -> float:
        """Log probability of ``token`` at ``position`` of a masked model: the same reference."""
        ids = torch.tensor([tokens], device=self.device)
        logits = _at_least_float32(self.model(input_ids=ids).logits[0, position])
        return float(torch.log_softmax(logits, -1)[token])

    @torch.inference_mode()
    def read(
        self,
        inputs: Mapping[str, Any],
        positions: IntArray,
        asked: IntArray,
        tokens: IntArray,
    ) -> FloatArray:
        """Log probability of ``tokens[e]`` at position ``positions[asked[e]]``.

        Parameters
        ----------
        inputs
            Keyword arguments of the model; ``input_ids`` has shape (rows, columns).
        positions
            Flat indices into (rows x columns), ascending, without repeats.
        asked, tokens
            For every log probability wanted, an index into ``positions`` and a token id;
            ``asked`` ascends.

        Returns
        -------
        Nats, float64, of the length of ``tokens``.
        """
        logits = self.logits(inputs, self.tensor(positions))
        return _log_probs(logits, self.tensor(asked), self.tensor(tokens)).cpu().numpy()

    def logits(self, inputs: Mapping[str, Any], positions: Tensor) -> Tensor:
        """Logits at ``positions``, shape (positions, vocabulary), in the model's dtype."""
        self._positions = positions
        try:
            logits: Tensor = self.model(**inputs).logits
        finally:
            self._positions = None
        rows, columns = inputs["input_ids"].shape
        # By shape, not by length, which would be a constant of an exported graph.
        if logits.shape[:2] == (1, positions.shape[0]):
            return logits[0]
        return logits.reshape(rows * columns, -1)[positions]

    def _keep_read(self, body: Any, args: Any, output: Any) -> Any:
        if self._positions is None:
            return output
        hidden = output[0]
        kept = hidden.reshape(-1, hidden.shape[-1])[self._positions][None]
        if isinstance(output, tuple):
            return (kept, *output[1:])
        output.last_hidden_state = kept
        return output


def _log_probs(logits: Tensor, asked: Tensor, tokens: Tensor) -> Tensor:
    """log softmax at (asked, tokens), float64, normalised in at least float32.

    Overwrites ``logits``, block by block: fewer passes over memory than ``torch.logsumexp``.
    """
    chosen = _at_least_float32(logits[asked, tokens]).double()
    block = max(1, _BLOCK[logits.device.type] // logits.shape[-1])
    normalisers = []
    for part in map(_at_least_float32, torch.split(logits, block)):
        highest = part.amax(-1, keepdim=True)
        normalisers.append(part.sub_(highest).exp_().sum(-1).log_() + highest[:, 0])
    return chosen - torch.cat(normalisers)[asked].double()


def _at_least_float32(tensor: Tensor) -> Tensor:
    return tensor if tensor.dtype == torch.float64 else tensor.float()
