"""Loads a model and its tokenizer with transformers: safetensors or GGUF, no code of its own.

What cannot be loaded is a ModelError of one line; transformers' own output is silenced.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

import torch
import transformers

from roomtables.errors import ModelError, RoomtablesError, first_line
from roomtables.lm.bounds import bounded_by_weights, refuse_counts
from roomtables.lm.causal import CausalBackend
from roomtables.lm.encoding import Encoder
from roomtables.lm.folders import ModelFolder, resolve
from roomtables.lm.forward import Forward
from roomtables.lm.gguf_loading import load_gguf_tokenizer, readable
from roomtables.lm.identity import device_class, scorer_id, scoring_kind
from roomtables.lm.kernels import accelerate
from roomtables.lm.masked import MaskedBackend
from roomtables.lm.scorer import SentenceScorer, threads_for, using_threads
from roomtables.lm.weights import refuse_where_short

_log = logging.getLogger(__name__)

# Tokens in one forward: on a CPU enough to keep the matrix products busy, on a GPU far more.
DEFAULT_TOKEN_BUDGET = {"cpu": 512, "cuda": 16384}
_CONTEXT_KEYS = ("max_position_embeddings", "n_positions", "n_ctx", "max_seq_len")


def load(
    model: str,
    *,
    revision: str | None,
    dtype: str,
    device: str,
    scoring: str | None,
    token_budget: int | None,
    progress: bool,
) -> SentenceScorer:
    """See :func:`roomtables.lm.load_scorer`."""
    place = device_class(device)
    if token_budget is not None and token_budget < 1:
        raise ModelError(f"the token budget is {token_budget}; give at least 1")
    folder = resolve(model, revision)
    kind = scoring_kind(folder, scoring)
    refuse_where_short(folder, dtype, place)
    identity = scorer_id(folder, dtype, place, kind)
    _quieten()
    tokenizer = _load_tokenizer(folder)
    network = load_network(folder, kind, dtype, place)
    accelerate(network)
    budget = token_budget or DEFAULT_TOKEN_BUDGET[place]
    parameters = sum(weight.numel() for weight in network.parameters())
    threads = threads_for(parameters, place)
    with using_threads(threads), _out_of_memory_named(folder, dtype):
        backend = _backend(network, tokenizer, folder, kind, budget)
    _log.info("%s on %s: strategy %s", identity, place, backend.strategy)
    return SentenceScorer(
        backend,
        scorer_id=identity,
        provenance={"model": model, "revision": folder.commit or revision or ""}
        | {"dtype": dtype, "scoring": kind, "parameters": str(parameters)}
        | _provenance(folder, backend, place),
        token_budget=budget,
        threads=threads,
        progress=progress,
    )


def _provenance(
    folder: ModelFolder, backend: CausalBackend | MaskedBackend, place: str
) -> dict[str, str]:
    file = folder.gguf
    return {
        "device": _device_name(place),
        "strategy": backend.strategy,
        "fallbacks": "; ".join(backend.fallbacks),
        "torch": torch.__version__,
        "transformers": transformers.__version__,
        **({"quantisation": file.quantisation, "gguf": version("gguf")} if file else {}),
    }


def _backend(
    network: Any, tokenizer: Any, folder: ModelFolder, kind: str, budget: int
) -> CausalBackend | MaskedBackend:
    context = _context(network.config.get_text_config())
    encoder = Encoder(tokenizer, folder.name, _vocabulary(network), context)
    if kind == "causal":
        return CausalBackend(Forward(network), encoder, budget)
    return MaskedBackend(Forward(network), encoder, whole_words=kind == "pll_word_l2r")


def _quieten() -> None:
    transformers.logging.set_verbosity_error()
    transformers.logging.disable_progress_bar()


def _load_tokenizer(folder: ModelFolder) -> Any:
    if folder.gguf:
        return load_gguf_tokenizer(folder)
    refuse_counts(folder)  # transformers reads the configuration here, too
    try:
        return transformers.AutoTokenizer.from_pretrained(
            folder.path, trust_remote_code=False, local_files_only=True
        )
    except Exception as error:  # a damaged file surfaces as any exception
        raise ModelError(
            f"{folder.name}: cannot read the tokenizer in {folder.path} ({first_line(error)}); "
            "save it again with tokenizer.save_pretrained()"
        ) from error


def load_network(folder: ModelFolder, kind: str, dtype: str, device: str) -> Any:
    """The transformers model of a folder or GGUF file, ready to run without gradients.

    Raises
    ------
    ModelError
        Its architecture is unknown, or its weights are damaged, incomplete or too large.
    MissingExtraError
        It is a GGUF file, and what reads one is not installed.
    """
    _quieten()
    if folder.gguf is None:
        _refuse_foreign_code(folder)
        refuse_counts(folder)
    auto = (
        transformers.AutoModelForCausalLM if kind == "causal" else transformers.AutoModelForMaskedLM
    )
    try:
        with (
            _out_of_memory_named(folder, dtype),
            bounded_by_weights(folder),
            readable(folder) as source,
        ):
            network, report = auto.from_pretrained(
                **source,
                dtype=getattr(torch, dtype),
                trust_remote_code=False,
                local_files_only=True,
                output_loading_info=True,
            )
            _refuse_missing_weights(folder, report)
            return network.eval().requires_grad_(False).to(device)
    except RoomtablesError:
        raise
    except Exception as error:  # unknown architecture, damaged weights, shapes that disagree
        raise ModelError(
            f"{folder.name}: transformers {transformers.__version__} cannot load it as a "
            f"{'causal' if kind == 'causal' else 'masked'} language model ({first_line(error)}); "
            "use another --model"
        ) from error


@contextmanager
def _out_of_memory_named(folder: ModelFolder, dtype: str) -> Iterator[None]:
    """Say in one line which model the GPU's memory is too small for."""
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        raise ModelError(
            f"{folder.name} does not fit into the GPU's memory in {dtype}; "
            "try --dtype float16, or --device cpu"
        ) from error


def _refuse_foreign_code(folder: ModelFolder) -> None:
    model_type = folder.model_type
    if model_type in transformers.CONFIG_MAPPING:
        return
    if "auto_map" in folder.config:
        raise ModelError(
            f"{folder.name} brings its own code, which is never run (trust_remote_code); "
            "use another --model"
        )
    raise ModelError(
        f"{folder.name}: transformers {transformers.__version__} knows no model type "
        f"{model_type!r}; upgrade transformers, or use another --model"
    )


def _refuse_missing_weights(folder: ModelFolder, report: Mapping[str, Any]) -> None:
    """Weights that a file lacks would be drawn at random, and the scores with them."""
    lacking = sorted(report.get("missing_keys") or []) + [
        str(key[0] if isinstance(key, tuple) else key)
        for key in report.get("mismatched_keys") or []
    ]
    if lacking:
        raise ModelError(
            f"{folder.name}: its weights lack {len(lacking)} tensor(s) such as {lacking[0]}; "
            "use a complete checkpoint with its language-modelling head"
        )


def _vocabulary(network: Any) -> int:
    return int(network.get_input_embeddings().num_embeddings)


def _context(config: Any) -> int | None:
    for key in _CONTEXT_KEYS:
        size = getattr(config, key, None)
        if isinstance(size, int) and size > 0:
            offset = getattr(config, "pad_token_id", None)
            if "roberta" in config.model_type or config.model_type == "camembert":
                return size - (offset or 0) - 1  # positions start after the padding index
            return size
    return None


def _device_name(device: str) -> str:
    return f"cuda ({torch.cuda.get_device_name()})" if device == "cuda" else device
