"""Tiny GGUF files, made from a model folder as llama.cpp converts one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gguf
import numpy as np
from safetensors.numpy import load_file, save_file

_NAMES = {
    "model.embed_tokens": "token_embd",
    "model.norm": "output_norm",
    "lm_head": "output",
    "input_layernorm": "attn_norm",
    "post_attention_layernorm": "ffn_norm",
    "self_attn.q_proj": "attn_q",
    "self_attn.k_proj": "attn_k",
    "self_attn.v_proj": "attn_v",
    "self_attn.o_proj": "attn_output",
    "mlp.gate_proj": "ffn_gate",
    "mlp.up_proj": "ffn_up",
    "mlp.down_proj": "ffn_down",
}


def gguf_name(name: str) -> str:
    """llama.cpp's name of a tensor of transformers' llama."""
    inner = name.removesuffix(".weight")
    if inner in _NAMES:
        return f"{_NAMES[inner]}.weight"
    _, _, layer, part = inner.split(".", 3)
    return f"blk.{layer}.{_NAMES[part]}.weight"


def rotary_order(weights: np.ndarray, heads: int) -> np.ndarray:
    """Rows of q or k as llama.cpp has them: the halves of a head interleaved."""
    halves = weights.reshape(heads, 2, weights.shape[0] // heads // 2, -1)
    return halves.swapaxes(1, 2).reshape(weights.shape)


def write_gguf(
    folder: Path, file: Path, *, quantised: bool = False, changes: Mapping[str, Any] | None = None
) -> Path:
    """The llama model in a folder as a GGUF file.

    With ``quantised``, matrices are stored as Q8_0, and the folder's weights become what that
    holds. ``changes`` are metadata that replace, or with ``None`` leave out, the file's own.
    """
    config = json.loads((folder / "config.json").read_text())
    weights = load_file(folder / "model.safetensors")
    writer = gguf.GGUFWriter(file, "llama")
    metadata = _metadata(config) | _tokenizer(folder) | dict(changes or {})
    for key, value in metadata.items():
        _add(writer, key, value)
    heads = {"attn_q": config["num_attention_heads"], "attn_k": config["num_key_value_heads"]}
    for name, values in weights.items():
        stored = values.astype(np.float32)
        kind = gguf.GGMLQuantizationType.F32
        turned = [count for part, count in heads.items() if part in gguf_name(name)]
        ordered = rotary_order(stored, *turned) if turned else stored
        if quantised and values.ndim > 1:
            kind = gguf.GGMLQuantizationType.Q8_0
            blocks = gguf.quants.quantize(ordered, kind)
            weights[name] = gguf.quants.dequantize(gguf.quants.quantize(stored, kind), kind)
            writer.add_tensor(gguf_name(name), blocks, raw_dtype=kind)
        else:
            writer.add_tensor(gguf_name(name), ordered)
    if quantised:
        save_file(weights, folder / "model.safetensors", metadata={"format": "pt"})
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()
    return file


def _metadata(config: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "general.name": "tiny",
        "llama.block_count": config["num_hidden_layers"],
        "llama.context_length": config["max_position_embeddings"],
        "llama.embedding_length": config["hidden_size"],
        "llama.feed_forward_length": config["intermediate_size"],
        "llama.attention.head_count": config["num_attention_heads"],
        "llama.attention.head_count_kv": config["num_key_value_heads"],
        "llama.attention.layer_norm_rms_epsilon": float(config["rms_norm_eps"]),
        "llama.rope.freq_base": float(config["rope_parameters"]["rope_theta"]),
    }


def _tokenizer(folder: Path) -> dict[str, Any]:
    model = json.loads((folder / "tokenizer.json").read_text())["model"]
    tokens = sorted(model["vocab"], key=model["vocab"].__getitem__)
    return {
        "tokenizer.ggml.model": "gpt2",
        "tokenizer.ggml.pre": "gpt-2",
        "tokenizer.ggml.tokens": tokens,
        "tokenizer.ggml.token_type": [3 if token.startswith("<|") else 1 for token in tokens],
        "tokenizer.ggml.merges": [" ".join(pair) for pair in model["merges"]],
        "tokenizer.ggml.bos_token_id": 0,
        "tokenizer.ggml.eos_token_id": 0,
        "tokenizer.ggml.add_bos_token": False,
    }


def _add(writer: gguf.GGUFWriter, key: str, value: Any) -> None:
    match value:
        case None:
            return
        case bool():
            writer.add_bool(key, value)
        case int():
            writer.add_uint32(key, value)
        case float():
            writer.add_float32(key, value)
        case str():
            writer.add_string(key, value)
        case list():
            writer.add_array(key, value)
        case _:
            raise TypeError(f"{key}: {value!r}")
