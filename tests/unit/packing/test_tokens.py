"""Tokens put together word by word against the tokenizer's own, and lists held in one array."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tokenizers import AddedToken, Tokenizer, models, normalizers, pre_tokenizers, processors

from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.packing.tokens import TokenLists, WordTokenizer, splits_at_spaces

SENTENCES = [
    "A room containing tv stands, sinks, and café-bars is called a rec/game room.",
    "A room containing tv stands, sinks, and café-bars is called an office.",
    "office",
]
# What a splitting pattern tells apart: letters, digits, marks, and whitespace of every kind.
texts = st.text(
    st.sampled_from("ab'stASİΣ1é中, .!\u0301🙂\0\n\t\u00a0\u2028    "), min_size=1, max_size=16
)


def household() -> Tokenizer:
    return Tokenizer.from_file(str(EMBEDDED_FOLDER / "tokenizer.json"))


def bare(**model: Any) -> Tokenizer:
    """A tokenizer of bytes, with one merge."""
    letters = sorted(pre_tokenizers.ByteLevel.alphabet())
    vocabulary = {piece: at for at, piece in enumerate([*letters, "Ġa"])}
    core = Tokenizer(models.BPE(vocabulary, [("Ġ", "a")], **model))
    core.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    return core


def ids(core: Tokenizer, sentences: list[str]) -> list[list[int]]:
    return [core.encode(sentence).ids for sentence in sentences]


class Counting:
    """Tokenises whole sentences, and counts them."""

    def __init__(self, core: Tokenizer) -> None:
        self.core = core
        self.asked = 0

    def __call__(self, sentences: Any) -> list[list[int]]:
        self.asked += len(sentences)
        return ids(self.core, sentences)


def test_words_give_the_tokens_of_the_sentence_without_tokenising_it() -> None:
    whole = Counting(household())
    tokens = WordTokenizer(household(), whole)
    before = whole.asked
    assert list(tokens(SENTENCES)) == ids(household(), SENTENCES)
    assert whole.asked == before


@given(st.lists(texts, min_size=1, max_size=4))
def test_any_text_has_the_tokens_of_the_tokenizer(given: list[str]) -> None:
    core = household()
    assert list(WordTokenizer(core, Counting(core))(given)) == ids(core, given)


def test_a_special_token_in_a_text_is_found() -> None:
    core = household()
    for text in ["a <s> b", "a<s>b c", "<s>"]:
        assert list(WordTokenizer(core, Counting(core))([text])) == ids(core, [text])


def test_a_prefix_space_stands_before_the_first_word_alone() -> None:
    core = bare()
    core.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=True)
    assert splits_at_spaces(core)
    assert list(WordTokenizer(core, Counting(core))(["a a", "b a"])) == ids(core, ["a a", "b a"])


def test_small_letters_are_the_same_word_by_word() -> None:
    core = bare()
    core.normalizer = normalizers.Lowercase()
    assert splits_at_spaces(core)
    sentences = ["B A b", "ΑΣ Σ İ AΣ"]
    assert list(WordTokenizer(core, Counting(core))(sentences)) == ids(core, sentences)


def test_a_special_token_in_capitals_is_found_where_letters_are_made_small() -> None:
    core = bare()
    core.normalizer = normalizers.Lowercase()
    # It takes the space behind it, so that the next word is not what it is on its own.
    core.add_tokens([AddedToken("<e>", rstrip=True, normalized=True)])
    assert splits_at_spaces(core)
    for text in ["b <e> a", "b <E> a"]:
        assert list(WordTokenizer(core, Counting(core))([text])) == ids(core, [text])


def _stripped(core: Tokenizer) -> None:
    core.normalizer = normalizers.Strip()


def _ending(core: Tokenizer) -> None:
    core.add_special_tokens(["<e>"])
    core.post_processor = processors.TemplateProcessing(
        single="$A <e>", special_tokens=[("<e>", core.token_to_id("<e>"))]
    )


def _metaspace(core: Tokenizer) -> None:
    core.pre_tokenizer = pre_tokenizers.Metaspace(split=False)


def _unsplit(core: Tokenizer) -> None:
    core.pre_tokenizer = pre_tokenizers.ByteLevel(use_regex=False)


def _spaced(core: Tokenizer) -> None:
    core.add_tokens([AddedToken("a b")])


def _truncating(core: Tokenizer) -> None:
    core.enable_truncation(2)


@pytest.mark.parametrize("change", [_stripped, _ending, _metaspace, _unsplit, _spaced, _truncating])
def test_other_tokenizers_are_asked_for_whole_sentences(change: Any) -> None:
    core = bare()
    assert splits_at_spaces(core)
    change(core)
    assert not splits_at_spaces(core)
    sentences = ["B a b a", "a a b"]
    assert list(WordTokenizer(core, Counting(core))(sentences)) == ids(core, sentences)


def test_random_merges_are_not_remembered() -> None:
    assert not splits_at_spaces(bare(dropout=0.5))


def test_no_sentences_have_no_tokens() -> None:
    assert list(WordTokenizer(household(), Counting(household()))([])) == []


@given(st.lists(st.lists(st.integers(0, 3), max_size=4), max_size=5))
def test_lists_come_back_as_they_were(lists: list[list[int]]) -> None:
    held = TokenLists.of(lists)
    assert list(held) == lists
    assert held[1:] == lists[1:]
    assert [held[at] for at in range(-len(lists), 0)] == lists
    shorter = [tokens[:-1] if tokens and tokens[-1] == 3 else tokens for tokens in lists]
    assert list(held.without_last(3)) == shorter
    assert held.lengths.dtype == np.int64
