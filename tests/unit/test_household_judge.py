"""What the judge says of a model, against whole sentences scored one by one."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

from pipeline.household_lm import judge as judging  # noqa: E402
from pipeline.household_lm.bayes import log_posterior  # noqa: E402
from pipeline.household_lm.facts import load_facts  # noqa: E402
from pipeline.household_lm.grammar import parse  # noqa: E402
from pipeline.household_lm.world import is_held_out  # noqa: E402
from tokenizers import Tokenizer  # noqa: E402

from roomtables.english import article, pluralise  # noqa: E402
from roomtables.lm.folders import EMBEDDED_FOLDER  # noqa: E402


def _log_probability(model: Any, ids: list[int]) -> float:
    with torch.no_grad():
        logits = model(torch.tensor([ids])).logits[0].log_softmax(-1)
    return float(sum(logits[at, token] for at, token in enumerate(ids[1:])))


def _log_softmax(scores: np.ndarray) -> np.ndarray:
    return np.asarray(scores - np.logaddexp.reduce(scores))


def test_the_judge_says_what_sentences_scored_one_by_one_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    facts = load_facts()
    model = transformers.AutoModelForCausalLM.from_pretrained(EMBEDDED_FOLDER, dtype=torch.float32)
    tokenizer = Tokenizer.from_file(str(EMBEDDED_FOLDER / "tokenizer.json"))
    monkeypatch.setattr(judging, "load_frames", lambda _: [parse("With {plurals} it is {a_room}.")])
    [found] = judging.judge(model.eval(), tokenizer, facts, sets=3, sizes=[1], seed=1)

    drawn = judging.object_sets(facts, 1, 3, seed=1)
    exact, right, kl, squares = log_posterior(facts, drawn), [], [], []
    for [name], expected in zip(drawn, exact, strict=True):
        sentences = [f"With {pluralise(name)} it is {article(r)} {r}." for r in facts.rooms]
        scores = [_log_probability(model, tokenizer.encode(text).ids) for text in sentences]
        said = _log_softmax(np.array(scores))
        kl.append(float((np.exp(expected) * (expected - said)).sum()))
        squares.append(float(((expected - said) ** 2).mean()))
        right.append(expected[said.argmax()] > expected.max() - 1e-6)
    assert found.kl == pytest.approx(np.mean(kl), abs=1e-4)
    assert found.log_error == pytest.approx(np.mean(squares) ** 0.5, abs=1e-4)
    assert found.accuracy == pytest.approx(np.mean(right))


def test_sets_of_several_objects_are_kept_out_of_the_corpus() -> None:
    facts = load_facts()
    sets = judging.object_sets(facts, 3, 20, seed=2)
    assert all(len(objects) == 3 and is_held_out(objects) for objects in sets)
    assert sets == judging.object_sets(facts, 3, 20, seed=2)
    names = [*facts.things]
    random.Random(0).shuffle(names)
    assert sum(is_held_out(names[at : at + 2]) for at in range(0, 1000, 2)) < 50
