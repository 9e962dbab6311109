"""Token ids of sentences in one array, and how sentences of few distinct words get theirs fast.

A byte-level tokenizer such as GPT-2's splits a text before every single space between words, and
tokenises the pieces one by one. Query sentences are made of a few hundred words, so each of those
is tokenised once, and a sentence is put together from the tokens of its words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Any, NamedTuple, overload

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]

_MOST_WORDS = 1 << 16  # whose tokens are remembered
_BREAK = "\0"  # between words; a sentence that holds one is not split
_SAMPLES = ("A room containing toilets, sinks, and café-bars is called a rec/game room.", "a")


@dataclass(frozen=True, eq=False)
class TokenLists(Sequence[list[int]]):
    """Lists of token ids: ``flat`` holds them one after the other, ``lengths`` how long each is."""

    flat: IntArray
    lengths: IntArray

    @classmethod
    def of(cls, lists: Iterable[Sequence[int]]) -> TokenLists:
        """Lists of Python's as arrays; arrays stay as they are."""
        if isinstance(lists, TokenLists):
            return lists
        lists = list(lists)
        lengths = np.fromiter(map(len, lists), np.int64, len(lists))
        return cls(np.fromiter(chain.from_iterable(lists), np.int64, lengths.sum()), lengths)

    def __len__(self) -> int:
        return len(self.lengths)

    @overload
    def __getitem__(self, index: int) -> list[int]: ...
    @overload
    def __getitem__(self, index: slice) -> list[list[int]]: ...
    def __getitem__(self, index: int | slice) -> list[int] | list[list[int]]:
        if isinstance(index, slice):
            return [self[at] for at in range(*index.indices(len(self)))]
        end = int(self.lengths[: range(len(self))[index] + 1].sum())
        tokens: list[int] = self.flat[end - int(self.lengths[index]) : end].tolist()
        return tokens

    def without_last(self, token: int) -> TokenLists:
        """The lists, each without its last token where that is ``token``."""
        ends = np.cumsum(self.lengths) - 1
        cut = np.zeros(len(self), bool)
        some = self.lengths > 0
        cut[some] = self.flat[ends[some]] == token
        return TokenLists(np.delete(self.flat, ends[cut]), self.lengths - cut)


def first_counted(text: str, offsets: Sequence[tuple[int, int]], start: int) -> int:
    """Which token of a text is the first that begins at character ``start`` or behind it.

    ``offsets`` are the characters that each token stands for, end excluded. Tokenizers disagree on
    whether a token's leading space is among them; here a token begins behind its leading spaces.
    The number of tokens, where none begins there.
    """
    for number, (begin, end) in enumerate(offsets):
        if begin >= start or (end > start and text[begin:start].isspace()):
            return number
    return len(offsets)


class Encoded(NamedTuple):
    """Sentences as tokens, and the first token of each that is scored, with all behind it.

    That is never a sentence's first token: it is a BOS, which is no part of the sentence, or it has
    no context.
    """

    tokens: TokenLists
    first: IntArray

    @property
    def counts(self) -> IntArray:
        """How many tokens of each sentence are scored."""
        return self.tokens.lengths - self.first


class _Word(NamedTuple):
    """A word's token ids, and the characters of the word that each of them stands for."""

    ids: Sequence[int]
    offsets: Sequence[tuple[int, int]]


_UNKNOWN = _Word((), ())  # it cannot be tokenised on its own


class WordTokenizer:
    """The tokens that a ``tokenizers.Tokenizer`` gives, word by word where that is the same.

    It is the same where :func:`splits_at_spaces` says so. Elsewhere, and for sentences with other
    whitespace or with special tokens in them, ``whole`` tokenises whole sentences. Threads may
    share one.
    """

    def __init__(
        self, core: Any, whole: Callable[[Sequence[str]], Iterable[Sequence[int]]]
    ) -> None:
        self._core = core
        self._whole = whole
        self._known: dict[str, _Word] = {}
        self._special: tuple[str, ...] = ()
        self._by_word = splits_at_spaces(core)
        if self._by_word:
            added = core.get_added_tokens_decoder().values()
            self._special = tuple(token.content.lower() for token in added)
            found = self._word_by_word(_SAMPLES)
            self._by_word = found is not None and list(found) == list(map(list, whole(_SAMPLES)))

    def __call__(self, sentences: Sequence[str]) -> TokenLists:
        """The token ids of each sentence, with the special tokens that the tokenizer puts there."""
        found = self._word_by_word(sentences) if self._by_word and len(sentences) else None
        return TokenLists.of(self._whole(sentences)) if found is None else found

    def first_counted(self, sentences: Sequence[str], starts: Sequence[int]) -> IntArray:
        """For each sentence the first token that begins at its start or behind it.

        See :func:`first_counted`.
        """
        pairs = zip(sentences, starts, strict=True)
        return np.fromiter((self._first_counted(*pair) for pair in pairs), np.int64, len(sentences))

    def _first_counted(self, sentence: str, start: int) -> int:
        texts = _split(sentence)
        words = [self._word(text) for text in texts] if self._by_word else [_UNKNOWN]
        if _UNKNOWN in words or _BREAK in sentence:
            return first_counted(sentence, self._core.encode(sentence).offsets, start)
        tokens = at = 0
        for text, word in zip(texts, words, strict=True):
            found = first_counted(text, word.offsets, start - at)
            tokens += found
            if found < len(word.ids):
                break
            at += len(text)
        return tokens

    def _word_by_word(self, sentences: Sequence[str]) -> TokenLists | None:
        """``None`` where some word cannot be tokenised on its own."""
        if _BREAK in "".join(sentences):
            return None
        split = list(map(_split, sentences))
        words = list(chain.from_iterable(split))
        number = dict(zip(dict.fromkeys(words), count(), strict=False))
        ids = [self._word(word).ids for word in number]
        if not all(ids):
            return None
        vocabulary = TokenLists.of(ids)
        used = np.fromiter(map(number.__getitem__, words), np.int64, len(words))
        lengths = vocabulary.lengths[used]
        # Each word's tokens, from where they begin in the vocabulary to where they go.
        begin = (np.cumsum(vocabulary.lengths) - vocabulary.lengths)[used]
        shift = begin - (np.cumsum(lengths) - lengths)
        flat = vocabulary.flat[np.repeat(shift, lengths) + np.arange(lengths.sum())]
        first = np.cumsum([0, *map(len, split[:-1])])
        return TokenLists(flat, np.add.reduceat(lengths, first))

    def _word(self, word: str) -> _Word:
        """A word's tokens; a sentence's first word, which has no space before it, has the special
        tokens before the sentence, too. No tokens: it cannot be tokenised on its own."""
        found = self._known.get(word)
        if found is None:
            bare = word.removeprefix(" ")
            small = word.lower()  # as the tokenizer may read it, too
            apart = bare.split() == [bare] and not any(name in small for name in self._special)
            found = _UNKNOWN
            if apart:
                encoding = self._core.encode(word, add_special_tokens=word == bare)
                found = _Word(encoding.ids, encoding.offsets) if encoding.ids else _UNKNOWN
            if len(self._known) >= _MOST_WORDS:
                self._known.clear()
            self._known[word] = found
        return found


def _split(sentence: str) -> list[str]:
    """A sentence's words, each but the first with the space before it."""
    return sentence.replace(" ", f"{_BREAK} ").split(_BREAK)


def splits_at_spaces(core: Any) -> bool:
    """Whether a ``tokenizers.Tokenizer`` tokenises the words of a text, and the space before each,
    independently of each other.

    So does byte-level splitting by GPT-2's pattern, in which no piece has a space behind another
    character, of a text that nothing changes before, or only letter by letter into small ones;
    special tokens may stand before it.
    """
    try:
        split, model = core.pre_tokenizer, core.model
        text, added = "a", core.get_added_tokens_decoder().values()
        bare = core.encode(text, add_special_tokens=False).ids
        return (
            type(core.normalizer).__name__ in ("NoneType", "Lowercase")
            and type(split).__name__ == "ByteLevel"
            and split.use_regex
            and not getattr(model, "dropout", None)
            and core.truncation is None
            and core.padding is None
            and not any(char.isspace() for token in added for char in token.content)
            and bool(bare)
            and core.encode(text).ids[-len(bare) :] == bare
        )
    except AttributeError:  # none of the tokenizers package
        return False
