"""Log probabilities of whole sentences from causal and masked language models.

The only part of roomtables that imports torch and transformers, and it does so when a model is
loaded. :func:`identify` names a scorer without them, unless it is to look for a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from roomtables.errors import needing
from roomtables.lm.address_space import check_address_space
from roomtables.lm.folders import EMBEDDED_MODEL
from roomtables.lm.identity import identify, identities

if TYPE_CHECKING:
    from roomtables.lm.scorer import SentenceScorer
    from roomtables.onnx_lm.scorer import OnnxScorer

__all__ = ["EMBEDDED_MODEL", "export_onnx", "identify", "identities", "load_scorer"]


def load_scorer(
    model: str = EMBEDDED_MODEL,
    *,
    revision: str | None = None,
    dtype: str = "float32",
    device: str = "cpu",
    scoring: str | None = None,
    token_budget: int | None = None,
    progress: bool = False,
) -> SentenceScorer:
    """Load a language model as a :class:`roomtables.scorer.Scorer` (log probabilities in nats).

    Parameters
    ----------
    model
        ``household-lm`` (embedded), a local folder, a GGUF file, or a name on the model hub.
    revision
        Branch, tag or commit of a hub model.
    dtype
        ``float32``, ``float16``, ``bfloat16`` or ``float64``; logsumexp is never below float32.
    device
        ``cpu``, ``cuda`` or ``auto`` (cuda where there is one).
    scoring
        ``causal``, ``pll`` (pseudo-log-likelihood) or ``pll_word_l2r``; None reads it from the
        model's configuration.
    token_budget
        Most tokens in one forward pass, which bounds memory; None for the device's default.
        Halved whenever memory runs out.
    progress
        Show a progress bar on stderr while scoring.

    Raises
    ------
    ModelError
        The model cannot be found, read, or used to score sentences; there is no room for it in
        memory; or torch does not fit into the address space that `ulimit -v` leaves.
    MissingExtraError
        torch or transformers, or for a GGUF file gguf or accelerate, is not installed.
    """
    check_address_space()
    with needing("loading a language model", "lm"):
        from roomtables.lm.loading import load

    return load(
        model,
        revision=revision,
        dtype=dtype,
        device=device,
        scoring=scoring,
        token_budget=token_budget,
        progress=progress,
    )


def export_onnx(
    folder: Path,
    sentences: Sequence[str],
    model: str = EMBEDDED_MODEL,
    *,
    starts: Sequence[int] | None = None,
    revision: str | None = None,
    dtype: str = "float32",
    scoring: str | None = None,
) -> OnnxScorer:
    """Write a causal model's ``model.onnx`` and ``tokenizer.json`` into a folder, and open them.

    Parameters
    ----------
    folder
        Made if it is not there. Where an error is raised, what is in it is of no use.
    sentences
        At least two, on which the file must be within 1e-3 nats of the model in torch.
    starts
        The characters from which tokens of the sentences count; None: all count.
    model, revision, dtype, scoring
        As in :func:`load_scorer`.

    Raises
    ------
    ModelError
        The model cannot be loaded, is a masked one, is too large for an ONNX file, does not
        convert, or scores otherwise once it is converted.
    MissingExtraError
        torch, transformers or onnx is not installed.
    """
    with needing("making an ONNX file", "lm"):
        from roomtables.lm.onnx_export import export
    return export(folder, sentences, starts, model, revision=revision, dtype=dtype, scoring=scoring)
