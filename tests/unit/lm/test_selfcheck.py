"""A fast path that is wrong is caught when the model is loaded, and the next one is taken."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from transformers import DynamicCache, GPT2LMHeadModel

from roomtables.errors import ModelError
from roomtables.lm import load_scorer
from unit.lm.conftest import room_sentences, save_model
from unit.lm.naive import causal_scores

SENTENCES = room_sentences(2, 4)


@pytest.fixture
def folder(model_folder: Callable[[str], Path]) -> Path:
    return model_folder("gpt2")


def check_scores(folder: Path, strategy: str) -> Any:
    scorer = load_scorer(str(folder))
    assert scorer.strategy == strategy
    expected = [score for score, _ in causal_scores(folder, SENTENCES)]
    assert [score.log_prob for score in scorer.score(SENTENCES)] == pytest.approx(
        expected, abs=1e-4
    )
    return scorer


def break_mask(monkeypatch: pytest.MonkeyPatch) -> None:
    """An architecture that ignores a packed mask: nodes see all earlier columns."""
    right = GPT2LMHeadModel.forward

    def blind(self: Any, *arguments: Any, attention_mask: Any = None, **inputs: Any) -> Any:
        if attention_mask is not None and attention_mask.dim() == 4:
            attention_mask = None
        return right(self, *arguments, attention_mask=attention_mask, **inputs)

    monkeypatch.setattr(GPT2LMHeadModel, "forward", blind)


def break_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """An architecture that does not use its cache: the prefix is forgotten."""
    right = DynamicCache.batch_repeat_interleave

    def forgetful(self: Any, repeats: int) -> None:
        right(self, repeats)
        for layer in self.layers:
            layer.values = torch.zeros_like(layer.values)

    monkeypatch.setattr(DynamicCache, "batch_repeat_interleave", forgetful)


def test_wrong_mask_falls_back_to_key_value(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    break_mask(monkeypatch)
    with caplog.at_level(logging.WARNING, logger="roomtables"):
        scorer = check_scores(folder, "kv")
    assert "trie" in caplog.text
    assert "nats from naive scoring" in caplog.text
    assert "trie: " in scorer.describe()["fallbacks"]


def test_wrong_mask_and_cache_fall_back_to_padding(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    break_mask(monkeypatch)
    break_cache(monkeypatch)
    check_scores(folder, "padded")


def test_rows_shrink_to_a_local_window(tmp_path: Path) -> None:
    """gpt_neo's local layers count columns, not depths: a row beyond the window is wrong."""
    folder = save_model(
        "gpt_neo", tmp_path / "gpt_neo", window_size=48, max_position_embeddings=512
    )
    scorer = check_scores(folder, "trie")
    assert "nats from naive scoring" in scorer.describe()["fallbacks"]


def test_half_precision_models_come_back_unchanged(folder: Path) -> None:
    model = load_scorer(str(folder), dtype="bfloat16").backend.forward.model
    fresh = type(model).from_pretrained(folder, dtype=torch.bfloat16)
    weights = dict(fresh.named_parameters())
    assert all(torch.equal(weight, weights[name]) for name, weight in model.named_parameters())
    buffers = dict(fresh.named_buffers())
    assert all(torch.equal(buffer, buffers[name]) for name, buffer in model.named_buffers())


def test_damaged_weights_are_refused(folder: Path, tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for file in folder.iterdir():
        (damaged / file.name).write_bytes(file.read_bytes())
    weights = load_file(damaged / "model.safetensors")
    weights["transformer.ln_f.weight"][:] = float("nan")
    save_file(weights, damaged / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(ModelError, match="damaged returns log probabilities that are not finite"):
        load_scorer(str(damaged))
