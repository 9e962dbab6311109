"""Causal scoring: same scores in any order, mixture and budget; bad input named; memory bounded."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roomtables.errors import ModelError
from roomtables.lm import load_scorer
from roomtables.lm.scorer import SentenceScorer
from roomtables.scorer import Scorer
from unit.lm.conftest import byte_level_tokenizer, room_sentences, save_model
from unit.lm.naive import causal_scores

SENTENCES = room_sentences(1, 3) + room_sentences(3, 4)


@pytest.fixture(scope="module")
def folder(model_folder: Callable[[str], Path]) -> Path:
    return model_folder("llama")


@pytest.fixture
def scorer(folder: Path) -> SentenceScorer:
    return load_scorer(str(folder))


@pytest.fixture(scope="module")
def by_budget(folder: Path) -> dict[int, SentenceScorer]:
    return {budget: load_scorer(str(folder), token_budget=budget) for budget in (1, 40, 300)}


@pytest.fixture(scope="module")
def expected(folder: Path) -> dict[str, float]:
    scores = causal_scores(folder, SENTENCES)
    return {text: score for text, (score, _) in zip(SENTENCES, scores, strict=True)}


def test_keeps_the_protocol(scorer: SentenceScorer) -> None:
    assert isinstance(scorer, Scorer)
    assert scorer.strategy == "trie"
    assert {"model", "revision", "dtype", "device", "scoring", "strategy", "torch"} <= set(
        scorer.describe()
    )


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    chosen=st.lists(st.sampled_from(SENTENCES), max_size=30),
    budget=st.sampled_from([1, 40, 300]),
)
def test_any_multiset_in_any_order_under_any_budget(
    chosen: list[str],
    budget: int,
    by_budget: dict[int, SentenceScorer],
    expected: dict[str, float],
) -> None:
    scores = [score.log_prob for score in by_budget[budget].score(chosen)]
    assert scores == pytest.approx([expected[text] for text in chosen], abs=1e-4)


def test_float64_is_exact(folder: Path) -> None:
    exact = load_scorer(str(folder), dtype="float64")
    naive = [
        exact.backend.forward.sequence(ids).sum() for ids in exact.backend.encode(SENTENCES).tokens
    ]
    scores = [score.log_prob for score in exact.score(SENTENCES)]
    assert scores == pytest.approx(naive, abs=1e-10)


@pytest.mark.parametrize(("dtype", "tolerance"), [("float16", 0.1), ("bfloat16", 1.0)])
def test_half_precision(
    folder: Path, expected: dict[str, float], dtype: str, tolerance: float
) -> None:
    half = load_scorer(str(folder), dtype=dtype)
    scores = [score.log_prob for score in half.score(SENTENCES)]
    assert half.strategy == "trie"
    assert scores == pytest.approx(list(expected.values()), abs=tolerance)
    assert scores != pytest.approx(list(expected.values()), abs=1e-6)


def test_stream_is_lazy_and_windowed(scorer: SentenceScorer) -> None:
    scorer.window = 8
    drawn = 0

    def endless() -> Iterator[str]:
        nonlocal drawn
        for text in itertools.cycle(SENTENCES):
            drawn += 1
            yield text

    scores = list(itertools.islice(scorer.score_stream(endless()), 20))
    assert drawn == 24
    np.testing.assert_allclose(scores, scorer.score(SENTENCES[:20]), atol=1e-5)


def test_nothing_to_score(scorer: SentenceScorer) -> None:
    assert scorer.score([]) == []


@pytest.mark.parametrize(
    ("sentence", "says"),
    [
        ("", "empty sentence"),
        ("  ", "empty sentence"),
        ("A", "too few to score"),
        ("A room containing beds " * 40, "more than the 64"),
    ],
)
def test_refused_sentences(scorer: SentenceScorer, sentence: str, says: str) -> None:
    with pytest.raises(ModelError, match=says) as caught:
        scorer.score([*SENTENCES, sentence])
    assert "llama" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_scores_that_are_not_finite_name_the_sentence(
    scorer: SentenceScorer, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = scorer.backend.log_probs

    def spoiled(*arguments: Any) -> Any:
        scores = good(*arguments)
        scores[2] = math.nan
        return scores

    monkeypatch.setattr(scorer.backend, "log_probs", spoiled)
    with pytest.raises(ModelError, match="nan") as caught:
        scorer.score(SENTENCES)
    assert SENTENCES[2] in str(caught.value)
    assert scorer.scorer_id in str(caught.value)


def test_memory_that_runs_out_halves_the_budget(
    scorer: SentenceScorer, expected: dict[str, float], caplog: pytest.LogCaptureFixture
) -> None:
    forward = scorer.backend.forward.model.forward

    def small(*arguments: Any, **inputs: Any) -> Any:
        if inputs["input_ids"].numel() > 100:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory")
        return forward(*arguments, **inputs)

    scorer.backend.forward.model.forward = small
    scores = [score.log_prob for score in scorer.score(SENTENCES)]
    assert scores == pytest.approx(list(expected.values()), abs=1e-4)
    assert scorer.token_budget == 64
    assert "out of memory" in caplog.text


def test_memory_that_never_suffices_is_an_error(scorer: SentenceScorer) -> None:
    def never(*arguments: Any, **inputs: Any) -> Any:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory")

    scorer.backend.forward.model.forward = never
    with pytest.raises(ModelError, match="out of memory"):
        scorer.score(SENTENCES)


def test_an_appended_eos_is_not_scored(folder: Path, tmp_path: Path) -> None:
    from tokenizers import processors

    tokenizer = byte_level_tokenizer()
    tokenizer.backend_tokenizer.post_processor = processors.TemplateProcessing(
        single="$A <|endoftext|>", special_tokens=[("<|endoftext|>", 0)]
    )
    appending = load_scorer(str(save_model("llama", tmp_path / "eos", tokenizer)))
    plain = load_scorer(str(folder))
    assert [score.token_count for score in appending.score(SENTENCES)] == [
        score.token_count for score in plain.score(SENTENCES)
    ]
    np.testing.assert_allclose(appending.score(SENTENCES), plain.score(SENTENCES), atol=1e-5)


def test_after_a_bos_the_first_token_is_scored(tmp_path: Path) -> None:
    from tokenizers import processors

    tokenizer = byte_level_tokenizer()
    tokenizer.backend_tokenizer.post_processor = processors.TemplateProcessing(
        single="<|endoftext|> $A", special_tokens=[("<|endoftext|>", 0)]
    )
    tokenizer.bos_token = "<|endoftext|>"
    place = save_model("llama", tmp_path / "bos", tokenizer)
    scorer = load_scorer(str(place))
    bare = [len(byte_level_tokenizer()(text)["input_ids"]) for text in SENTENCES]
    assert [score.token_count for score in scorer.score(SENTENCES)] == bare
    expected = [score for score, _ in causal_scores(place, SENTENCES)]
    scores = [score.log_prob for score in scorer.score(SENTENCES)]
    assert scores == pytest.approx(expected, abs=1e-4)
    assert scorer.score(["A"])[0].token_count == 1


def test_sentences_beyond_an_attention_window_are_right(tmp_path: Path) -> None:
    narrow = save_model("mistral", tmp_path / "narrow", sliding_window=12)
    scorer = load_scorer(str(narrow))
    expected = [score for score, _ in causal_scores(narrow, SENTENCES)]
    scores = [score.log_prob for score in scorer.score(SENTENCES)]
    assert scorer.strategy == "trie"
    assert scores == pytest.approx(expected, abs=1e-4)


def test_progress_tells_sentences_tokens_and_savings(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    load_scorer(str(folder), progress=True).score(SENTENCES)
    shown = capsys.readouterr()
    assert f"{len(SENTENCES)}/{len(SENTENCES)}" in shown.err
    assert "tokens run" in shown.err
    assert "% saved" in shown.err
    assert shown.out == ""
    load_scorer(str(folder)).score(SENTENCES)
    assert capsys.readouterr().err == ""


def test_minicons_agrees(model_folder: Callable[[str], Path]) -> None:
    minicons = pytest.importorskip("minicons.scorer")
    folder = model_folder("gpt2")
    tokenizer = byte_level_tokenizer()
    tokenizer.pad_token = tokenizer.eos_token
    from transformers import AutoModelForCausalLM

    peer = minicons.IncrementalLMScorer(
        AutoModelForCausalLM.from_pretrained(folder), "cpu", tokenizer=tokenizer
    )
    theirs = peer.sequence_score(
        SENTENCES, reduction=lambda values: values.sum(0).item(), bos_token=False
    )
    ours = [score.log_prob for score in load_scorer(str(folder)).score(SENTENCES)]
    assert ours == pytest.approx(theirs, abs=1e-3)
