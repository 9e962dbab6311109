"""Log probabilities of whole sentences from causal and masked language models.

The only part of roomtables that imports torch and transformers, and it does so when a model is
loaded. :func:`identify` names a scorer without them, unless it is to look for a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from roomtables.errors import MissingExtraError
from roomtables.lm.address_space import check_address_space
from roomtables.lm.folders import EMBEDDED_MODEL
from roomtables.lm.identity import identify

if TYPE_CHECKING:
    from roomtables.lm.scorer import SentenceScorer

__all__ = ["EMBEDDED_MODEL", "identify", "load_scorer"]


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
        ``household-lm`` (embedded), a local folder, or a name on the model hub.
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
        The model cannot be found, read, or used to score sentences; or torch does not fit into the
        address space that `ulimit -v` leaves.
    MissingExtraError
        torch or transformers is not installed.
    """
    check_address_space()
    try:
        from roomtables.lm.loading import load
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in {"torch", "transformers", "safetensors"}:
            raise
        raise MissingExtraError("loading a language model", "lm") from error
    return load(
        model,
        revision=revision,
        dtype=dtype,
        device=device,
        scoring=scoring,
        token_budget=token_budget,
        progress=progress,
    )
