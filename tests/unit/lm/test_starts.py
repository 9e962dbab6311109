"""Scores of the end of a sentence, against one plain forward per sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import transformers

from roomtables.errors import ModelError
from roomtables.lm import load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.onnx_lm import OnnxScorer
from roomtables.packing.tokens import first_counted
from unit.lm.conftest import OBJECTS, ROOMS

SENTENCES = [f"Things found in a {room}: {thing} and beds." for room in ROOMS for thing in OBJECTS]
STARTS = [sentence.index(":") for sentence in SENTENCES]


def naive(folder: Path, sentence: str, start: int) -> tuple[float, int]:
    """Log probability of the tokens whose first visible character is at the start or behind it."""
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    model = transformers.AutoModelForCausalLM.from_pretrained(folder, dtype=torch.float32).eval()
    encoded = tokenizer(sentence, return_offsets_mapping=True)
    ids = encoded["input_ids"]
    with torch.no_grad():
        log_probs = model(torch.tensor([ids])).logits[0].double().log_softmax(-1)
    total, count = 0.0, 0
    for place, (begin, end) in enumerate(encoded["offset_mapping"]):
        piece = sentence[begin:end]
        visible = begin + len(piece) - len(piece.lstrip())
        if place and visible >= start:
            total += float(log_probs[place - 1, ids[place]])
            count += 1
    return total, count


@pytest.mark.parametrize("architecture", ["llama", "bloom", "openai-gpt"])  # trie, kv, padded
def test_only_tokens_behind_the_start_count(
    architecture: str, model_folder: Callable[[str], Path]
) -> None:
    folder = model_folder(architecture)
    scores = load_scorer(str(folder)).score(SENTENCES, STARTS)
    for at in range(0, len(SENTENCES), 6):
        log_prob, count = naive(folder, SENTENCES[at], STARTS[at])
        assert scores[at].log_prob == pytest.approx(log_prob, abs=1e-4)
        assert scores[at].token_count == count


def masked(folder: Path, sentence: str, start: int, within_words: bool) -> tuple[float, int]:
    """Pseudo-log-likelihood of the same tokens, each masked in a copy of its own."""
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    model = transformers.AutoModelForMaskedLM.from_pretrained(folder).eval()
    encoded = tokenizer(sentence, return_offsets_mapping=True)
    ids, words = encoded["input_ids"], encoded.word_ids()
    total, count = 0.0, 0
    for place, (begin, end) in enumerate(encoded["offset_mapping"]):
        piece = sentence[begin:end]
        if words[place] is None or begin + len(piece) - len(piece.lstrip()) < start:
            continue
        hidden = [
            at == place or (within_words and at > place and words[at] == words[place])
            for at in range(len(ids))
        ]
        copy = [tokenizer.mask_token_id if h else i for h, i in zip(hidden, ids, strict=True)]
        with torch.no_grad():
            row = model(torch.tensor([copy])).logits[0, place].double().log_softmax(-1)
        total += float(row[ids[place]])
        count += 1
    return total, count


@pytest.mark.parametrize("architecture", ["bert", "roberta"])
@pytest.mark.parametrize("scoring", ["pll", "pll_word_l2r"])
def test_masked_models_score_only_tokens_behind_the_start(
    architecture: str, scoring: str, model_folder: Callable[[str], Path]
) -> None:
    folder = model_folder(architecture)
    asked = range(0, len(SENTENCES), 5)
    scores = load_scorer(str(folder), scoring=scoring).score(
        [SENTENCES[at] for at in asked], [STARTS[at] for at in asked]
    )
    for score, at in zip(scores, asked, strict=True):
        log_prob, count = masked(folder, SENTENCES[at], STARTS[at], scoring == "pll_word_l2r")
        assert score.log_prob == pytest.approx(log_prob, abs=1e-4)
        assert score.token_count == count


def test_onnx_scores_only_tokens_behind_the_start() -> None:
    sentences = [f"In a {room} there are {thing}." for room in ROOMS for thing in OBJECTS][:8]
    starts = [sentence.index(" there") for sentence in sentences]
    scores = OnnxScorer.open(EMBEDDED_FOLDER).score(sentences, starts)
    for score, sentence, start in zip(scores, sentences, starts, strict=True):
        log_prob, count = naive(EMBEDDED_FOLDER, sentence, start)
        assert score.log_prob == pytest.approx(log_prob, abs=1e-3)
        assert score.token_count == count


def test_one_sentence_with_two_starts_has_two_scores(model_folder: Callable[[str], Path]) -> None:
    folder = model_folder("llama")
    starts = [0, STARTS[0], STARTS[0] + 2]
    scores = load_scorer(str(folder)).score([SENTENCES[0]] * 3, starts)
    for score, start in zip(scores, starts, strict=True):
        expected, count = naive(folder, SENTENCES[0], start)
        assert score.log_prob == pytest.approx(expected, abs=1e-4)
        assert score.token_count == count


def test_nothing_behind_the_start_is_refused(model_folder: Callable[[str], Path]) -> None:
    with pytest.raises(ModelError, match="no token to score behind the start"):
        load_scorer(str(model_folder("llama"))).score(SENTENCES[:1], [len(SENTENCES[0])])


@pytest.mark.parametrize("text", ["one  two three", "a b", "mississippi is"])
@pytest.mark.parametrize("spaces_inside", [True, False])
def test_a_token_begins_behind_its_spaces(text: str, spaces_inside: bool) -> None:
    words = [match.span() for match in re.finditer(r" *\S+", text)]
    visible = [end - len(text[begin:end].lstrip()) for begin, end in words]
    offsets = (
        words
        if spaces_inside
        else [(begin, end) for begin, (_, end) in zip(visible, words, strict=True)]
    )
    for start in range(len(text) + 1):
        expected = sum(begin < start for begin in visible)
        assert first_counted(text, offsets, start) == expected
