"""Whether a tokenizer made of a GGUF file gives the tokens that the file means.

What goes wrong in between: a pre-tokenizer that cuts words where the merges were learnt across, a
space that is lost or added, merges that are lost, text that becomes unknown tokens, a BOS that is
put or left out against what the file says. Each is compared with the file's own list of tokens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from roomtables.errors import ModelError
from roomtables.lm.gguf import TOKEN_TYPES, TOKENS

PROBES = (
    "A room containing toilets is called a bathroom.",
    "Things that you usually find in a rec/game room: washing machines, 12 chairs & a TV-stand",
)
_NORMAL, _UNKNOWN = 1, 2  # token types
_BYTE_LEVEL, _SENTENCE_PIECE = "gpt2", "llama"
_SPACE = "▁"  # sentencepiece's
_SAMPLE = 10_000
_MOST_CUT = 0.01  # of the vocabulary's words: a few are camel case, or of a tokenizer before


@dataclass(frozen=True)
class Vocabulary:
    """The tokens of a GGUF file as it spells them, their types, and its other keys."""

    tokens: Sequence[str]
    types: Sequence[int]
    metadata: Mapping[str, Any]

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> Vocabulary:
        """The vocabulary in a file's metadata.

        Raises
        ------
        ModelError
            There is none.
        """
        tokens, types = metadata.get(TOKENS), metadata.get(TOKEN_TYPES)
        if not isinstance(tokens, list) or not tokens:
            raise ModelError(f"a GGUF file without a tokenizer ({TOKENS}); use another --model")
        return cls(tokens, types or [_NORMAL] * len(tokens), metadata)

    @property
    def kind(self) -> str:
        """How tokens are spelled: ``gpt2`` (bytes as letters), ``llama`` (sentencepiece), …"""
        return str(self.metadata.get("tokenizer.ggml.model"))

    def setting(self, name: str) -> Any:
        return self.metadata.get(f"tokenizer.ggml.{name}")

    def text(self, tokens: Sequence[int]) -> str:
        """What the file's own spelling of some tokens says."""
        content = b"".join(self._bytes(self.tokens[token]) for token in tokens)
        return content.decode(errors="replace")

    def _bytes(self, token: str) -> bytes:
        if self.kind == _BYTE_LEVEL and self._letters.keys() >= set(token):
            return bytes(self._letters[letter] for letter in token)
        if len(token) == 6 and token.startswith("<0x") and token.endswith(">"):
            return bytes.fromhex(token[3:5])
        return token.replace(_SPACE, " ").encode()

    @cached_property
    def _letters(self) -> dict[str, int]:
        """The byte that each letter of a byte-level vocabulary stands for, as in GPT-2: printable
        ones for themselves, the others, in order, from U+0100 on."""
        plain = [*range(33, 127), *range(161, 173), *range(174, 256)]
        others = [byte for byte in range(256) if byte not in plain]
        return {chr(byte): byte for byte in plain} | {
            chr(256 + place): byte for place, byte in enumerate(others)
        }

    def spelled(self, text: str) -> str:
        """How the file spells a text of ASCII letters and spaces."""
        return text.replace(" ", "Ġ" if self.kind == _BYTE_LEVEL else _SPACE)


def disagreement(tokenizer: Any, vocabulary: Vocabulary) -> str | None:
    """What a tokenizer does otherwise than the file says; ``None`` where nothing was found."""
    for probe in PROBES:
        tokens = tokenizer(probe)["input_ids"]
        wrong = _wrong_bos(tokenizer, vocabulary, tokens) or _wrong_tokens(
            vocabulary, probe, _bare(tokenizer, tokens)
        )
        if wrong:
            return wrong
    return _wrong_cuts(tokenizer, vocabulary)


def _bare(tokenizer: Any, tokens: Sequence[int]) -> Sequence[int]:
    """The tokens of the sentence itself, less a BOS before it and an EOS behind it."""
    start = 1 if tokens[:1] == [tokenizer.bos_token_id] else 0
    end = len(tokens) - 1 if tokens[-1:] == [tokenizer.eos_token_id] else len(tokens)
    return tokens[start:end]


def _wrong_bos(tokenizer: Any, vocabulary: Vocabulary, tokens: Sequence[int]) -> str | None:
    """llama.cpp adds a BOS to a sentencepiece vocabulary that does not say otherwise."""
    stated, bos = vocabulary.setting("add_bos_token"), vocabulary.setting("bos_token_id")
    expected = vocabulary.kind == _SENTENCE_PIECE if stated is None else bool(stated)
    if bos is None or vocabulary.kind not in (_BYTE_LEVEL, _SENTENCE_PIECE):
        return None
    if (tokens[:1] == [bos]) == expected:
        return None
    return "it puts a BOS first, the file says not to" if not expected else "it puts no BOS first"


def _wrong_tokens(vocabulary: Vocabulary, probe: str, tokens: Sequence[int]) -> str | None:
    unknown = [t for t in tokens if vocabulary.types[t] == _UNKNOWN]
    if unknown:
        return f"text becomes the unknown token {vocabulary.tokens[unknown[0]]!r}"
    prefixed = vocabulary.kind == _SENTENCE_PIECE and vocabulary.setting("add_space_prefix")
    said, expected = vocabulary.text(tokens), " " * bool(prefixed) + probe
    if vocabulary.kind == _SENTENCE_PIECE and vocabulary.setting("add_space_prefix") is None:
        said, expected = said.strip(), probe.strip()
    if said != expected:
        return f"its tokens say {said[:60]!r}"
    known = set(vocabulary.tokens)
    words = [vocabulary.spelled(f" {word}") for word in probe.split()[1:] if word.isalpha()]
    whole = {vocabulary.tokens[token] for token in tokens}
    lost = [word for word in words if word in known and word not in whole]
    return f"it cuts the token {lost[0]!r}" if lost else None


def _wrong_cuts(tokenizer: Any, vocabulary: Vocabulary) -> str | None:
    """Tokens that the tokenizer can never give, since it cuts text inside of them first."""
    core = tokenizer.backend_tokenizer
    if vocabulary.kind != _BYTE_LEVEL or core.pre_tokenizer is None:
        return None
    normal = [t for t, kind in enumerate(vocabulary.types) if kind == _NORMAL]
    texts = [vocabulary.text([token]) for token in normal[:: max(1, len(normal) // _SAMPLE)]]
    words = [text for text in texts if text.isascii() and text.strip() and len(text) > 1]
    cut = [text for text in words if len(core.pre_tokenizer.pre_tokenize_str(text)) > 1]
    if len(cut) <= _MOST_CUT * len(words):
        return None
    pre = str(vocabulary.setting("pre"))[:40]
    return f"its pre-tokenizer is not the file's, {pre!r}: it cuts the token {cut[0]!r}"
