"""Every architecture scores like a naive loop, whatever strategy its self-check chose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from roomtables.lm import load_scorer
from unit.lm.conftest import CAUSAL, MASKED, room_sentences
from unit.lm.naive import causal_scores, masked_scores

# What is known of each; a change here is worth a look, not an error in the scores.
FASTEST = {"falcon_alibi": "kv", "bloom": "kv", "mpt": "kv", "openai-gpt": "padded"}
FASTEST["mamba"] = "padded"


@pytest.mark.parametrize("architecture", CAUSAL)
def test_causal_architecture(architecture: str, model_folder: Callable[[str], Path]) -> None:
    folder = model_folder(architecture)
    sentences = room_sentences(2, 5)[::-1] + room_sentences(1, 3)
    scorer = load_scorer(str(folder))
    expected = causal_scores(folder, sentences)
    scores = scorer.score(sentences)
    assert [score.log_prob for score in scores] == pytest.approx(
        [log_prob for log_prob, _ in expected], abs=1e-4
    )
    assert [score.token_count for score in scores] == [count for _, count in expected]
    assert scorer.strategy == FASTEST.get(architecture, "trie"), scorer.describe()["fallbacks"]


@pytest.mark.parametrize("architecture", MASKED)
def test_masked_architecture(architecture: str, model_folder: Callable[[str], Path]) -> None:
    folder = model_folder(architecture)
    sentences = room_sentences(2, 1)[::-1] + room_sentences(1, 1)  # some 180 masked copies
    scorer = load_scorer(str(folder))
    expected = masked_scores(folder, sentences)
    scores = scorer.score(sentences)
    assert [score.log_prob for score in scores] == pytest.approx(
        [log_prob for log_prob, _ in expected], abs=1e-4
    )
    assert [score.token_count for score in scores] == [count for _, count in expected]
    assert (scorer.strategy, scorer.describe()["scoring"]) == ("masked", "pll")
