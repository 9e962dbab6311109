"""Which sentences a language model can score, by their tokens, and what is said of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from roomtables.errors import ModelError


@dataclass(frozen=True)
class TokenLimits:
    """What a model knows and reads.

    Attributes
    ----------
    name : the model's, for messages
    vocabulary : the number of tokens that it knows
    context : the most tokens of a sentence that it reads; ``None``: no limit
    appended_eos : the token that its tokenizer puts last, which is not scored; ``None``: none
    """

    name: str
    vocabulary: int
    context: int | None
    appended_eos: int | None = None

    def refuse_empty(self, sentences: Sequence[str]) -> None:
        """Refuse what is no text, or holds none.

        Raises
        ------
        ModelError
            A sentence is empty.
        """
        for sentence in sentences:
            if not isinstance(sentence, str) or not sentence.strip():
                raise ModelError(f"{self.name} cannot score an empty sentence ({sentence!r})")

    def check_all(
        self,
        sentences: Sequence[str],
        tokens: npt.NDArray[np.int64],
        lengths: npt.NDArray[np.int64],
    ) -> None:
        """Refuse sentences that a causal model cannot score.

        ``tokens`` holds the token ids of all of them, one sentence after the other, and
        ``lengths`` how many each has. Raises as :meth:`check`, for the first of them.
        """
        longest = self.context or lengths.max(initial=0)
        if (
            lengths.min(initial=2) >= 2
            and lengths.max(initial=0) <= longest
            and tokens.max(initial=0) < self.vocabulary
        ):
            return
        ends = np.cumsum(lengths)
        for sentence, length, end in zip(sentences, lengths, ends, strict=True):
            self.check(sentence, tokens[end - length : end].tolist(), fewest=2)

    def first_scored(
        self,
        sentences: Sequence[str],
        first_counted: npt.NDArray[np.int64] | None,
        lengths: npt.NDArray[np.int64],
    ) -> npt.NDArray[np.int64]:
        """The first token of each sentence that a causal model scores: never the very first.

        ``first_counted`` is the first of each that counts (``None``: all count), and ``lengths``
        how many tokens each has.

        Raises
        ------
        ModelError
            No token of a sentence is left to score.
        """
        if first_counted is None:
            return np.ones(len(sentences), np.int64)
        first: npt.NDArray[np.int64] = np.maximum(first_counted, 1)
        for row in np.flatnonzero(first >= lengths).tolist():
            self.refuse_uncounted(sentences[row])
        return first

    def refuse_uncounted(self, sentence: str) -> None:
        """Refuse a sentence with no token behind the start that was asked for.

        Raises
        ------
        ModelError
            Always.
        """
        raise ModelError(
            f"{self.name} sees no token to score behind the start given for {quoted(sentence)}; "
            "let the scored part be longer"
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
        if max(tokens) >= self.vocabulary:
            raise ModelError(
                f"the tokenizer of {self.name} gives token {max(tokens)}, but the model knows only "
                f"{self.vocabulary}; save the tokenizer that the model was trained with"
            )


def quoted(sentence: str) -> str:
    """The sentence for an error message, shortened in the middle of a long one."""
    return repr(sentence if len(sentence) <= 120 else f"{sentence[:80]}…{sentence[-30:]}")
