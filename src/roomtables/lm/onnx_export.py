"""A causal language model written as an ONNX file, checked against torch before it is handed on.

The graph takes what :mod:`roomtables.packing` lays out and returns log probabilities (see
:data:`roomtables.onnx_lm.facts.INPUTS`), in float32. Weights that a half precision holds without
loss are stored in it, and cast when the file is opened.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import torch
from tokenizers import Tokenizer
from torch import Tensor, nn

from roomtables.errors import ModelError, first_line
from roomtables.lm.causal import CausalBackend
from roomtables.lm.encoding import PROBES, Encoder
from roomtables.lm.folders import ModelFolder, resolve
from roomtables.lm.forward import Forward
from roomtables.lm.identity import on_every_device, scoring_kind
from roomtables.lm.loading import load, load_network
from roomtables.lm.scorer import SentenceScorer
from roomtables.lm.strategies import ROW_NODES, packed_inputs
from roomtables.onnx_lm.facts import (
    INPUTS,
    METADATA_KEY,
    MODEL_FILE,
    PACKED,
    PADDED,
    TOKENIZER_FILE,
    OnnxFacts,
)
from roomtables.onnx_lm.scorer import OnnxScorer
from roomtables.scorer import TOLERANCE_NATS

_OPSET = 18  # old enough for every runtime that the extra `robot` takes
_INSTEAD = "leave --with-model out, and install `roomtables[lm]` on the robot"
LARGEST_FILE = 2_000_000_000  # bytes: a protocol buffer ends at 2 GiB
_SMALL_TENSOR = 1024  # numbers, below which storing halves saves nothing
_PROBES = 2
_HALVES = {torch.float16: onnx.TensorProto.FLOAT16, torch.bfloat16: onnx.TensorProto.BFLOAT16}


def export(
    folder: Path,
    sentences: Sequence[str],
    starts: Sequence[int] | None,
    model: str,
    *,
    revision: str | None,
    dtype: str,
    scoring: str | None,
) -> OnnxScorer:
    """See :func:`roomtables.lm.export_onnx`."""
    source = resolve(model, revision)
    if scoring_kind(source, scoring) != "causal":
        raise ModelError(f"{model} is a masked language model, which needs torch; {_INSTEAD}")
    network = load_network(source, "causal", "float32", "cpu")
    _refuse_large(network, model)
    scorer = load(
        model,
        revision=revision,
        dtype=dtype,
        device="cpu",
        scoring=scoring,
        token_budget=None,
        progress=False,
    )
    expected = [score.log_prob for score in scorer.score(sentences, starts)]
    encoder = cast(CausalBackend, scorer.backend).encoder
    tokenizer = _tokenizer_json(encoder, source, sentences)
    facts = replace(
        _facts(source.name, scorer, tokenizer),
        scorer_ids=on_every_device(source, dtype, scoring),
        probe=tuple(sentences[:_PROBES]),
        probe_nats=tuple(expected[:_PROBES]),
        probe_starts=tuple(starts[:_PROBES]) if starts else (),
    )
    content = _with_facts(_convert(network, facts.graph, model), facts)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MODEL_FILE).write_bytes(content)
    (folder / TOKENIZER_FILE).write_bytes(tokenizer)
    return _checked(folder, model, (sentences, starts), expected)


def _refuse_large(network: nn.Module, model: str) -> None:
    size = sum(
        weights.numel() * (4 if _half(weights) is None else 2) for weights in network.parameters()
    )
    if size > LARGEST_FILE:
        raise ModelError(
            f"{model} is too large for an ONNX file ({size / 1e9:.1f} of at most "
            f"{LARGEST_FILE / 1e9:.0f} GB); {_INSTEAD}"
        )


def _checked(folder: Path, model: str, asked: tuple[Any, Any], expected: list[float]) -> OnnxScorer:
    """The scorer of a folder's files, which gives sentences with starts the scores expected."""
    try:
        made = OnnxScorer.open(folder, probe=False)
        found = [score.log_prob for score in made.score(*asked)]
    except ModelError as error:  # what converts need not be what the runtime runs
        raise _unconverted(model, error) from error
    apart = np.abs(np.subtract(found, expected)).max(initial=0.0)
    if not apart <= TOLERANCE_NATS:
        raise ModelError(
            f"{model} in ONNX, which computes in float32, is {apart:.2g} nats from its scores with "
            f"torch in {made.facts.dtype}, more than {TOLERANCE_NATS}; build the tables with "
            f"--dtype float32, or {_INSTEAD}"
        )
    return made


def _unconverted(model: str, error: BaseException) -> ModelError:
    return ModelError(
        f"{model} does not convert to ONNX ({first_line(error.__cause__ or error)}); {_INSTEAD}"
    )


def _facts(name: str, scorer: SentenceScorer, tokenizer: bytes) -> OnnxFacts:
    """What the file is to say, but for the identities and the probe."""
    backend, provenance = cast(CausalBackend, scorer.backend), scorer.describe()
    limits = backend.encoder.limits
    contexts = [size for size in (limits.context, backend.window) if size]
    return OnnxFacts(
        model=name,
        revision=provenance["revision"],
        dtype=provenance["dtype"],
        scorer_ids=(),
        graph=PACKED if backend.strategy == "trie" else PADDED,
        row_nodes=backend.row_nodes or ROW_NODES,
        vocabulary=limits.vocabulary,
        context=min(contexts, default=None),
        appended_eos=limits.appended_eos,
        parameters=int(provenance["parameters"]),
        tokenizer_sha256=sha256(tokenizer).hexdigest(),
        probe=(),
        probe_nats=(),
    )


def _tokenizer_json(encoder: Encoder, source: ModelFolder, sentences: Sequence[str]) -> bytes:
    """The content of a ``tokenizer.json`` that gives, by itself, the tokens that torch scores.

    The model's own file where that does, else what its tokenizer is once it is loaded.
    """
    asked = [*PROBES, *sentences]
    expected = encoder.call(asked)["input_ids"]
    own = source.path / TOKENIZER_FILE
    candidates = [own.read_bytes()] if own.is_file() else []
    core = getattr(encoder.tokenizer, "backend_tokenizer", None)
    if isinstance(core, Tokenizer):
        candidates.append(core.to_str().encode())
    for content in candidates:
        alone = Tokenizer.from_str(content.decode())
        alone.no_truncation()
        alone.no_padding()
        if [encoding.ids for encoding in alone.encode_batch_fast(asked)] == expected:
            return content
    raise ModelError(
        f"the tokenizer of {encoder.name} does not work without transformers; use another --model"
    )


class _Packed(nn.Module):
    """The graph of a model that takes rows of a token trie; log probabilities in nats, [asked]."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self._forward = Forward(network)

    def forward(
        self,
        token: Tensor,
        depth: Tensor,
        end: Tensor,
        positions: Tensor,
        asked: Tensor,
        target: Tensor,
    ) -> Tensor:
        inputs = packed_inputs(token, depth, end, self._forward.dtype)
        logits = self._forward.logits(inputs, positions)
        return torch.log_softmax(logits, -1)[asked, target]


class _Padded(nn.Module):
    """The graph of any other model: what pads a sentence on its right is seen by nothing in it."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self._forward = Forward(network)

    def forward(self, token: Tensor, positions: Tensor, asked: Tensor, target: Tensor) -> Tensor:
        inputs = {"input_ids": token, "use_cache": False}
        logits = self._forward.logits(inputs, positions)
        return torch.log_softmax(logits, -1)[asked, target]


def _convert(network: nn.Module, graph: str, model: str) -> onnx.ModelProto:
    """The model's graph with its weights, as PyTorch's exporter writes it."""
    rows, columns, positions, asked = map(torch.export.Dim, ("rows", "columns", "read", "asked"))
    # Numbers that differ from each other, so that none is taken for a constant of the model.
    grid = torch.arange(2 * 7).reshape(2, 7) % 5
    places, edges = torch.arange(9), torch.arange(11)
    of_grid: dict[int, Any] = {0: rows, 1: columns}
    examples = {
        "token": (grid, of_grid),
        "depth": (torch.arange(7).repeat(2, 1), of_grid),
        "end": (torch.full((2, 7), 7), of_grid),
        "positions": (places, {0: positions}),
        "asked": (edges % 9, {0: asked}),
        "target": (edges % 5, {0: asked}),
    }
    used = {name: examples[name] for name in INPUTS[graph]}
    module = (_Packed if graph == PACKED else _Padded)(network).eval()
    try:
        with _silently(), torch.no_grad():
            program = torch.onnx.export(
                module,
                tuple(example for example, _ in used.values()),
                dynamo=True,
                input_names=list(used),
                output_names=["log_prob"],
                dynamic_shapes=tuple(shape for _, shape in used.values()),
                opset_version=_OPSET,
                verbose=False,
            )
    except Exception as error:  # whatever an architecture does that the exporter cannot follow
        raise _unconverted(model, error) from error
    proto: onnx.ModelProto = cast(Any, program).model_proto
    return proto


@contextmanager
def _silently() -> Iterator[None]:
    """Without the exporter's remarks on its own progress."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _with_facts(proto: onnx.ModelProto, facts: OnnxFacts) -> bytes:
    """The file's content: weights in half precision where that is exact, facts, no remarks."""
    casts = [node for weights in proto.graph.initializer if (node := _halve(weights))]
    nodes = [*casts, *proto.graph.node]
    for node in nodes:  # the exporter notes where in its own files each came from
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    del proto.graph.node[:], proto.graph.value_info[:], proto.functions[:]
    proto.graph.node.extend(nodes)
    onnx.helper.set_model_props(proto, {METADATA_KEY: facts.to_json()})
    return bytes(proto.SerializeToString())


def _halve(weights: onnx.TensorProto) -> onnx.NodeProto | None:
    """Store float32 weights as halves, where exact; the cast that gives them their name back."""
    if weights.data_type != onnx.TensorProto.FLOAT:
        return None
    values = torch.from_numpy(np.array(onnx.numpy_helper.to_array(weights)))
    half = _half(values)
    if half is None or values.numel() < _SMALL_TENSOR:
        return None
    name = weights.name
    stored = onnx.helper.make_tensor(
        f"{name}.half",
        _HALVES[half],
        list(values.shape),
        values.to(half).view(torch.int16).numpy().tobytes(),
        raw=True,
    )
    weights.CopyFrom(stored)
    return onnx.helper.make_node("Cast", [f"{name}.half"], [name], to=onnx.TensorProto.FLOAT)


def _half(weights: Tensor) -> torch.dtype | None:
    """The half precision that holds all of the weights exactly, if one does."""
    for dtype in _HALVES:
        if torch.equal(weights.to(dtype).to(weights.dtype), weights):
            return dtype
    return None
