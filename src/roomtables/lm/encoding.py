"""From sentences to the tokens that are scored.

They are exactly the tokens that the tokenizer's own call returns, less an EOS that it appends;
nothing is added. The first of them is never scored: it is either a BOS, which is no part of the
sentence, or it has no context. Where only the end of a sentence counts, the tokens are those of the
whole sentence all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from roomtables.errors import ModelError
from roomtables.packing.tokens import (
    Encoded,
    IntArray,
    TokenLists,
    WordTokenizer,
    first_counted,
)
from roomtables.token_limits import TokenLimits

_PROBE = "A room containing toilets is called a bathroom."
PROBES = (
    _PROBE,
    "a",
    "Washing machines, rec/game rooms & cafés:  é 中 \n <|endoftext|> [SEP] </s>",
)
_UNLIMITED = 1_000_000  # tokenizers without a limit say 1e30


class Encoder:
    """Turns sentences into token ids, and refuses those that cannot be scored.

    ``vocabulary`` is the number of tokens that the model knows, ``context`` the most it reads
    (``None``: no limit but the tokenizer's). ``name`` is the model's, for messages.

    Raises
    ------
    ModelError
        The tokenizer finds no tokens in a plain sentence.
    """

    def __init__(self, tokenizer: Any, name: str, vocabulary: int, context: int | None) -> None:
        self.tokenizer = tokenizer
        self.name = name
        limit = getattr(tokenizer, "model_max_length", None) or _UNLIMITED
        limits = [size for size in (context, limit) if size and size < _UNLIMITED]
        self.context = int(min(limits)) if limits else None
        self.limits = TokenLimits(name, vocabulary, self.context)
        self.limits = replace(self.limits, appended_eos=self._find_appended_eos())
        self._by_word: WordTokenizer | None = None
        self._tokens = self._find_fastest()

    def encode(self, sentences: Sequence[str], starts: Sequence[int] | None = None) -> Encoded:
        """Token ids of each sentence; those from its start on are scored, but never the first.

        Raises
        ------
        ModelError
            A sentence is empty, holds nothing to score, or is longer than the model's context; or
            the tokenizer cannot tell where a token begins.
        """
        self.limits.refuse_empty(sentences)
        tokens = self._tokens(sentences)
        if self.limits.appended_eos is not None:
            tokens = tokens.without_last(self.limits.appended_eos)
        self.limits.check_all(sentences, tokens.flat, tokens.lengths)
        found = None if starts is None else self._first_counted(sentences, starts)
        return Encoded(tokens, self.limits.first_scored(sentences, found, tokens.lengths))

    def offsets(self, sentences: Sequence[str]) -> list[list[tuple[int, int]]]:
        """The characters of a sentence that each token stands for, end excluded.

        Raises
        ------
        ModelError
            The tokenizer cannot tell.
        """
        if not self.tokenizer.is_fast:
            raise ModelError(
                f"the tokenizer of {self.name} cannot tell where a token begins, which scoring "
                "after_room needs; drop `scored` from build.toml, or use another --model"
            )
        found: list[list[tuple[int, int]]]
        found = self.call(sentences, return_offsets_mapping=True)["offset_mapping"]
        return found

    def _first_counted(self, sentences: Sequence[str], starts: Sequence[int]) -> IntArray:
        if self._by_word:
            return self._by_word.first_counted(sentences, starts)
        offsets = self.offsets(sentences)
        return np.array(list(map(first_counted, sentences, offsets, starts)), np.int64)

    def call(self, sentences: Sequence[str], **options: Any) -> Any:
        """What the tokenizer's own call returns, without padding, truncation or masks.

        Raises
        ------
        ModelError
            A sentence is empty or no text.
        """
        self.limits.refuse_empty(sentences)
        return self.tokenizer(
            list(sentences),
            padding=False,
            truncation=False,
            return_attention_mask=False,
            return_token_type_ids=False,
            verbose=False,
            **options,
        )

    def sample_tokens(self) -> tuple[list[int], list[int]]:
        """The special token put before a sentence (or no token), and the ids of ordinary ones."""
        special = set(self.tokenizer.all_special_ids)
        lead = [token for token in self.call([_PROBE])["input_ids"][0][:1] if token in special]
        known = min(self.limits.vocabulary, len(self.tokenizer))
        return lead, [token for token in range(known) if token not in special] or [0]

    def _find_fastest(self) -> Callable[[Sequence[str]], TokenLists]:
        """The tokenizer's Rust core where it gives the tokens of the whole call, word by word where
        it can; else the whole call."""

        def whole(sentences: Sequence[str]) -> TokenLists:
            return TokenLists.of(self.call(sentences)["input_ids"])

        try:
            core = self.tokenizer.backend_tokenizer
            direct = WordTokenizer(
                core, lambda some: [each.ids for each in core.encode_batch_fast(list(some))]
            )
            if list(direct(PROBES)) == list(whole(PROBES)):
                self._by_word = direct
                return direct
        except (AttributeError, TypeError):  # a tokenizer without such a core
            pass
        return whole

    def _find_appended_eos(self) -> int | None:
        eos = self.tokenizer.eos_token_id
        whole = self.call([_PROBE])["input_ids"][0]
        bare = self.call([_PROBE], add_special_tokens=False)["input_ids"][0]
        if not whole:
            raise ModelError(f"the tokenizer of {self.name} finds no tokens in {_PROBE!r}")
        appended = whole[-1] == eos and (not bare or bare[-1] != eos)
        return eos if appended else None
