"""Pseudo-log-likelihood, plain and within words, against a naive loop and minicons."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import transformers

from roomtables.errors import ModelError
from roomtables.lm import load_scorer
from unit.lm.conftest import room_sentences, save_model, word_piece_tokenizer

SENTENCES = [*room_sentences(2, 3), "An armchair, unseen zebras and a bed?"]
# For tests that run each masked copy by itself: sentences of five lengths.
FEW = [*SENTENCES[:6], SENTENCES[-1]]


@pytest.mark.parametrize("architecture", ["bert", "roberta", "modernbert"])
@pytest.mark.parametrize(
    ("scoring", "metric"), [("pll", "original"), ("pll_word_l2r", "within_word_l2r")]
)
def test_minicons_agrees(
    scoring: str, metric: str, architecture: str, model_folder: Callable[[str], Path]
) -> None:
    minicons = pytest.importorskip("minicons.scorer")
    folder = model_folder(architecture)
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    model = transformers.AutoModelForMaskedLM.from_pretrained(folder)
    peer = minicons.MaskedLMScorer(model, "cpu", tokenizer=tokenizer)
    # Encoded by hand: minicons still calls a method that transformers 5 no longer has.
    encoded = tokenizer(SENTENCES, padding=True)
    theirs = peer.sequence_score(
        encoded, reduction=lambda values: values.sum(0).item(), PLL_metric=metric
    )
    ours = load_scorer(str(folder), scoring=scoring).score(SENTENCES)
    assert [score.log_prob for score in ours] == pytest.approx(theirs, abs=1e-4)


def test_the_variant_differs_only_in_words_of_several_pieces(
    model_folder: Callable[[str], Path],
) -> None:
    folder = str(model_folder("bert"))
    plain, within = (load_scorer(folder, scoring=scoring) for scoring in ("pll", "pll_word_l2r"))
    tokenizer = plain.backend.encoder.tokenizer
    differences = {True: [0.0], False: [0.0]}
    for text in SENTENCES:
        words = tokenizer(text).word_ids()[1:-1]
        one_piece_each = len(words) == len(set(words))
        difference = plain.score([text])[0].log_prob - within.score([text])[0].log_prob
        differences[one_piece_each].append(abs(difference))
    assert max(differences[True]) < 1e-4
    assert max(differences[False]) > 1e-3  # a sentence may differ by chance in little alone
    assert plain.scorer_id != within.scorer_id


def test_identical_masked_inputs_run_once(model_folder: Callable[[str], Path]) -> None:
    scorer = load_scorer(str(model_folder("bert")))
    run: list[tuple[int, ...]] = []

    def note(model: Any, arguments: Any, inputs: dict[str, Any]) -> None:
        for ids, present in zip(inputs["input_ids"], inputs["attention_mask"], strict=True):
            run.append(tuple(ids[present.bool()].tolist()))

    scorer.backend.forward.model.register_forward_pre_hook(note, with_kwargs=True)
    copies = sum(score.token_count for score in scorer.score(SENTENCES))
    assert len(run) == len(set(run)) < copies


def test_any_budget_gives_the_same_scores(model_folder: Callable[[str], Path]) -> None:
    folder = str(model_folder("roberta"))
    reference = [score.log_prob for score in load_scorer(folder).score(FEW)]
    for budget in (1, 64):
        scores = load_scorer(folder, token_budget=budget).score(FEW[::-1])
        assert [score.log_prob for score in scores][::-1] == pytest.approx(reference, abs=1e-4)


def test_batches_that_disagree_are_not_used(
    model_folder: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from transformers import BertForMaskedLM

    right = BertForMaskedLM.forward

    def wrong_in_batches(self: Any, input_ids: Any = None, **inputs: Any) -> Any:
        output = right(self, input_ids=input_ids, **inputs)
        if len(input_ids) > 1:
            output.logits = output.logits.flip(-1)
        return output

    folder = str(model_folder("bert"))
    expected = [score.log_prob for score in load_scorer(folder).score(FEW)]
    monkeypatch.setattr(BertForMaskedLM, "forward", wrong_in_batches)
    scorer = load_scorer(folder)
    scores = [score.log_prob for score in scorer.score(FEW)]
    assert "batches disagree" in scorer.describe()["fallbacks"]
    assert scores == pytest.approx(expected, abs=1e-4)


def test_a_tokenizer_without_a_mask_token_is_refused(tmp_path: Path) -> None:
    tokenizer = word_piece_tokenizer()
    tokenizer.mask_token = None
    with pytest.raises(ModelError, match="no mask token"):
        load_scorer(str(save_model("bert", tmp_path / "maskless", tokenizer)))


@pytest.mark.parametrize(("sentence", "says"), [(" ", "empty"), ("beds " * 80, "more than the 65")])
def test_refused_sentences(sentence: str, says: str, model_folder: Callable[[str], Path]) -> None:
    with pytest.raises(ModelError, match=says):
        load_scorer(str(model_folder("roberta"))).score([sentence])
