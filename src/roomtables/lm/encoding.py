"""From sentences to the tokens that are scored.

They are exactly the tokens that the tokenizer's own call returns, less an EOS that it appends;
nothing is added. The first of them is never scored: it is either a BOS, which is no part of the
sentence, or it has no context.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from roomtables.errors import ModelError

_PROBE = "A room containing toilets is called a bathroom."
_PROBES = (
    _PROBE,
    "a",
    "Washing machines, rec/game rooms & cafés:  é 中 \n <|endoftext|> [SEP] </s>",
)
_UNLIMITED = 1_000_000  # tokenizers without a limit say 1e30


class Encoder:
    """Turns sentences into token ids (lists of int), and refuses those that cannot be scored.

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
        self._vocabulary = vocabulary
        limit = getattr(tokenizer, "model_max_length", None) or _UNLIMITED
        limits = [size for size in (context, limit) if size and size < _UNLIMITED]
        self.context = int(min(limits)) if limits else None
        self._appended_eos = self._find_appended_eos()
        self._direct = self._find_direct_call()

    def encode(self, sentences: Sequence[str]) -> list[list[int]]:
        """Token ids of each sentence; all but the first are scored.

        Raises
        ------
        ModelError
            A sentence is empty, holds nothing to score, or is longer than the model's context.
        """
        _refuse_empty(sentences, self.name)
        ids = self._direct(sentences)
        eos = self._appended_eos
        if eos is not None:
            ids = [tokens[:-1] if tokens and tokens[-1] == eos else tokens for tokens in ids]
        for sentence, tokens in zip(sentences, ids, strict=True):
            self.check(sentence, tokens, fewest=2)
        return list(ids)

    def call(self, sentences: Sequence[str], **options: Any) -> Any:
        """What the tokenizer's own call returns, without padding, truncation or masks.

        Raises
        ------
        ModelError
            A sentence is empty or no text.
        """
        _refuse_empty(sentences, self.name)
        return self.tokenizer(
            list(sentences),
            padding=False,
            truncation=False,
            return_attention_mask=False,
            return_token_type_ids=False,
            verbose=False,
            **options,
        )

    def check(self, sentence: str, tokens: Sequence[int], fewest: int) -> None:
        """Refuse ``tokens`` that the model cannot score.

        Raises
        ------
        ModelError
            They are fewer than ``fewest``, more than the model reads, or unknown to the model.
        """
        if len(tokens) < fewest:
            raise ModelError(
                f"{self.name} sees {len(tokens)} token(s) in {quoted(sentence)}, too few to score; "
                "use a longer sentence"
            )
        if self.context is not None and len(tokens) > self.context:
            raise ModelError(
                f"{quoted(sentence)} has {len(tokens)} tokens, more than the {self.context} that "
                f"{self.name} reads; ask for fewer objects (-k), or use another --model"
            )
        if max(tokens) >= self._vocabulary:
            raise ModelError(
                f"the tokenizer of {self.name} gives token {max(tokens)}, but the model knows only "
                f"{self._vocabulary}; save the tokenizer that the model was trained with"
            )

    def sample_tokens(self) -> tuple[list[int], list[int]]:
        """The special token put before a sentence (or no token), and the ids of ordinary ones."""
        special = set(self.tokenizer.all_special_ids)
        lead = [token for token in self.call([_PROBE])["input_ids"][0][:1] if token in special]
        known = min(self._vocabulary, len(self.tokenizer))
        return lead, [token for token in range(known) if token not in special] or [0]

    def _find_direct_call(self) -> Callable[[Sequence[str]], list[list[int]]]:
        """The tokenizer's Rust core where it gives the tokens of the whole call, in half the time;
        else the whole call."""

        def whole(sentences: Sequence[str]) -> list[list[int]]:
            ids: list[list[int]] = self.call(sentences)["input_ids"]
            return ids

        def direct(sentences: Sequence[str]) -> list[list[int]]:
            core = self.tokenizer.backend_tokenizer
            return [encoding.ids for encoding in core.encode_batch_fast(list(sentences))]

        try:
            return direct if direct(_PROBES) == whole(_PROBES) else whole
        except (AttributeError, TypeError):  # a tokenizer without such a core
            return whole

    def _find_appended_eos(self) -> int | None:
        eos = self.tokenizer.eos_token_id
        whole = self.call([_PROBE])["input_ids"][0]
        bare = self.call([_PROBE], add_special_tokens=False)["input_ids"][0]
        if not whole:
            raise ModelError(f"the tokenizer of {self.name} finds no tokens in {_PROBE!r}")
        appended = whole[-1] == eos and (not bare or bare[-1] != eos)
        return eos if appended else None


def _refuse_empty(sentences: Sequence[str], name: str) -> None:
    for sentence in sentences:
        if not isinstance(sentence, str) or not sentence.strip():
            raise ModelError(f"{name} cannot score an empty sentence ({sentence!r})")


def quoted(sentence: str) -> str:
    """The sentence for an error message, shortened in the middle of a long one."""
    return repr(sentence if len(sentence) <= 120 else f"{sentence[:80]}…{sentence[-30:]}")
