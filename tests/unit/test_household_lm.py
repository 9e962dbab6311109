"""The embedded model: its size, its BOS rule, and whether its common sense is common."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest
from pipeline.household_lm.generate import KINDS
from pipeline.household_lm.grammar import FRAMES, read_lines

from roomtables.lm import load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER

DATA = Path(__file__).parents[1] / "data"
PAIRS = ["household_pairs.csv", "household_pairs_2.csv"]


@pytest.fixture(params=PAIRS)
def pairs(request: pytest.FixtureRequest) -> list[tuple[str, str]]:
    with (DATA / request.param).open(encoding="utf-8", newline="") as lines:
        return [(row["sensible"], row["other"]) for row in csv.DictReader(lines)]


def test_the_model_is_small_and_holds_no_pickle() -> None:
    files = [path for path in EMBEDDED_FOLDER.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 16 * 2**20
    kinds = {".safetensors", ".onnx", ".json", ".md", ".png", ".csv"}
    assert {path.suffix for path in files} <= kinds
    assert (EMBEDDED_FOLDER / "README.md").is_file()


def test_the_tokenizer_puts_bos_first_and_nothing_last() -> None:
    transformers = pytest.importorskip("transformers")
    tokenizer = transformers.AutoTokenizer.from_pretrained(EMBEDDED_FOLDER)
    ids = tokenizer("A lamp is lit.")["input_ids"]
    assert ids[0] == tokenizer.bos_token_id
    assert ids.count(tokenizer.bos_token_id) == 1
    assert tokenizer.decode(ids[1:]) == "A lamp is lit."


def test_it_prefers_what_makes_sense(pairs: list[tuple[str, str]]) -> None:
    pytest.importorskip("transformers")
    assert len(pairs) == len(set(pairs)) == 200
    scorer = load_scorer("household-lm")
    scores = scorer.score([sentence for pair in pairs for sentence in pair])
    wrong = [
        pair
        for pair, sensible, other in zip(pairs, scores[::2], scores[1::2], strict=True)
        if sensible.log_prob <= other.log_prob
    ]
    assert len(wrong) <= 0.1 * len(pairs), wrong


def test_the_pairs_are_phrased_as_nothing_in_the_corpus(pairs: list[tuple[str, str]]) -> None:
    kinds = [*KINDS, "walks", "walk_openings", "held_out"]
    lines = [line for kind in kinds for line in read_lines(FRAMES / f"{kind}.txt")]
    patterns = [re.compile(_as_pattern(line), re.IGNORECASE) for line in lines]
    for sentence in (sentence for pair in pairs for sentence in pair):
        assert not any(pattern.fullmatch(sentence) for pattern in patterns), sentence


def _as_pattern(line: str) -> str:
    """A regular expression of all that a frame can say: a slot may be anything."""
    escaped = re.escape(line).replace(r"\[", "(?:").replace(r"\]", ")").replace(r"\|", "|")
    return re.sub(r"\\\{\w+\\\}", ".+", escaped)
