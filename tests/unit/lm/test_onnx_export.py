"""A causal model in ONNX scores as it does in torch, or is refused in one line."""

from __future__ import annotations

import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from roomtables import RoomTables, build
from roomtables.cli import main
from roomtables.errors import ModelError
from roomtables.lm import export_onnx, identities, load_scorer, onnx_export
from roomtables.onnx_lm import MODEL_FILE, OnnxScorer
from support import HashScorer, small_space, write_space
from unit.lm.conftest import CAUSAL, OBJECTS, byte_level_tokenizer, room_sentences, save_model

SENTENCES = room_sentences(2, 5)[::-1] + room_sentences(1, 3)
LONG = [f"A room containing {' and '.join(OBJECTS[:size])} is called a kitchen." for size in (4, 5)]

# What is known of each; a change here is worth a look, not an error in the scores.
GRAPHS = {"bloom": "padded", "mpt": "padded", "openai-gpt": "padded"}
REFUSED = {
    "falcon_alibi",  # multiplies booleans, which the runtime does not
    "mamba",  # its scan becomes as many steps as the example had tokens
}


def check(model: Path, folder: Path, graph: str = "trie") -> OnnxScorer:
    """The model in ONNX, which scores as torch does what it was not checked on when it was made."""
    made = export_onnx(folder, SENTENCES[:10], str(model))
    opened = OnnxScorer.open(folder)
    assert opened.facts == made.facts
    assert opened.facts.scorer_ids == identities(str(model))
    asked = SENTENCES + LONG[: 1 if (opened.facts.context or 64) < 40 else 2]
    scorer = load_scorer(str(model))
    scores, expected = opened.score(asked), scorer.score(asked)
    assert [score.token_count for score in scores] == [score.token_count for score in expected]
    found = [score.log_prob for score in scores]
    np.testing.assert_allclose(found, [score.log_prob for score in expected], atol=1e-3, rtol=0)
    assert opened.strategy == graph
    return opened


def bracketing_tokenizer() -> Any:
    """Puts a BOS before a sentence and an EOS behind it."""
    from tokenizers import processors

    tokenizer = byte_level_tokenizer()
    tokenizer.backend_tokenizer.post_processor = processors.TemplateProcessing(
        single="<|endoftext|> $A <|endoftext|>", special_tokens=[("<|endoftext|>", 0)]
    )
    tokenizer.bos_token = "<|endoftext|>"
    return tokenizer


def test_a_model_of_full_precision_with_bos_and_eos(tmp_path: Path) -> None:
    model = save_model("gpt2", tmp_path / "gpt2", bracketing_tokenizer(), n_layer=1)
    scorer = check(model, tmp_path / "onnx")
    assert scorer.facts.appended_eos == 0
    assert scorer.score(["A"])[0].token_count == 1
    text = (tmp_path / "onnx" / MODEL_FILE).read_bytes()
    assert str(tmp_path).encode() not in text  # nothing of this machine
    assert b"site-packages" not in text


@pytest.mark.slow
@pytest.mark.parametrize("architecture", CAUSAL)
def test_causal_architecture(
    architecture: str, model_folder: Callable[[str], Path], tmp_path: Path
) -> None:
    if architecture in REFUSED:
        with pytest.raises(ModelError, match="does not convert to ONNX") as refused:
            export_onnx(tmp_path / "onnx", SENTENCES, str(model_folder(architecture)))
        assert "\n" not in str(refused.value)
    else:
        check(model_folder(architecture), tmp_path / "onnx", GRAPHS.get(architecture, "trie"))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float16", "bfloat16"])
def test_half_weights_are_kept_exactly_and_half_arithmetic_is_refused(
    dtype: str, model_folder: Callable[[str], Path], tmp_path: Path
) -> None:
    import torch
    import transformers

    folder = model_folder("llama")
    network = transformers.AutoModelForCausalLM.from_pretrained(folder, dtype=getattr(torch, dtype))
    network.save_pretrained(tmp_path / "model")
    byte_level_tokenizer().save_pretrained(tmp_path / "model")
    check(tmp_path / "model", tmp_path / "onnx")
    small = (tmp_path / "onnx" / MODEL_FILE).stat().st_size
    export_onnx(tmp_path / "full", SENTENCES, str(folder))
    assert small < 0.8 * (tmp_path / "full" / MODEL_FILE).stat().st_size
    with pytest.raises(ModelError, match=f"with torch in {dtype}, more than"):
        export_onnx(tmp_path / "half", SENTENCES, str(folder), dtype=dtype)


def test_masked_models_are_refused(model_folder: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="masked"):
        export_onnx(tmp_path / "onnx", SENTENCES, str(model_folder("bert")))
    assert not (tmp_path / "onnx").exists()


def test_models_beyond_a_protocol_buffer_are_refused(
    model_folder: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnx_export, "LARGEST_FILE", 10_000)
    with pytest.raises(ModelError, match="too large"):
        export_onnx(tmp_path / "onnx", SENTENCES, str(model_folder("gpt2")))
    assert not (tmp_path / "onnx").exists()


def test_tables_of_another_model_are_packed_without_it_or_not_at_all(tmp_path: Path) -> None:
    labels = str(write_space(tmp_path / "labels", small_space()))
    build(tables=tmp_path / "tables", scorer=HashScorer(), labels=labels)
    archive = tmp_path / "out" / "tables.tar"
    archive.parent.mkdir()
    command = ["export", "--with-model", "-o", str(archive), "--labels", "small"]
    done = CliRunner().invoke(main, [*command, "--tables", str(tmp_path / "tables")])
    assert done.exit_code == 1
    assert "scored by hash@1, the model here is household-lm@" in done.output
    assert done.output.count("\n") == 1
    assert list(archive.parent.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "wording", [{}, {"template": "In {room} there are {objects}.", "scored": "after_room"}]
)
def test_tables_travel_with_their_model(
    wording: dict[str, str], tmp_path: Path, model_folder: Callable[[str], Path]
) -> None:
    model = model_folder("llama")
    labels = str(write_space(tmp_path / "labels", small_space()))
    tables = tmp_path / "tables"
    options = {
        "labels": labels,
        "combinations": "none",
        "model": str(model),
        "device": "cpu",
    } | wording
    build(tables=tables, **options)
    archive = tmp_path / "tables.tar"
    command = ["export", "--with-model", "-o", str(archive), "--labels", "small"]
    assert CliRunner().invoke(main, [*command, "--tables", str(tables)]).exit_code == 0
    with tarfile.open(archive) as members:
        members.extractall(tmp_path / "robot", filter="data")
    model.rename(model.with_name("gone"))
    try:
        robot = RoomTables.open(tmp_path / "robot", "small", rule="query")
        found = robot.classify(["bed", "sink", "stove"])
        robot.version.verify()
    finally:
        model.with_name("gone").rename(model)
    here = RoomTables.open(tables, "small", rule="query", scorer=load_scorer(str(model)))
    expected = here.classify(["bed", "sink", "stove"])
    assert (found.room, found.answered_by) == (expected.room, "lm")
    assert found.probabilities == pytest.approx(expected.probabilities, abs=1e-3)
