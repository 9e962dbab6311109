"""From what a robot calls a thing to an object of the label space.

A name is read in this order, and the first that fits wins:

1. a name of the label space as it stands: a label, a plural or a synonym;
2. one of them in another spelling: case, ``_``, ``-``, camelCase, spaces, and what tells instances
   apart (``chair_12``, ``Chair-2``, ``chair.003``, ``chair (2)``, ``chair12``) do not matter, nor
   does a remark behind it (``iron_(for_clothing)``, ``cabinet-merged``);
3. the longest tail of a compound that is one (``wooden dining chair``: ``dining chair``); of
   ``bottle of water`` or ``mirror on the wall`` what stands first.

A name that lists several (``door, double door``, ``sofa/couch``) is the first of them that is read.
"""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

from roomtables.labels import LABEL, PLURAL, SYNONYM, Name, normalise

SPELLING, COMPOUND = "spelling", "compound"

# A longer name is no name of a thing; it is not taken apart.
_LONGEST = 200
_LONGEST_COMPARED = 60  # the same, for suggestions
_LEAST_RATIO = 0.7  # of difflib: less alike is no suggestion
_SUGGESTED = 1_000  # names whose suggestions are remembered

# Of two labels that a spelling fits, the one with the stronger claim has it.
_CLAIMS = {LABEL: 0, SYNONYM: 1, PLURAL: 2}

_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_APOSTROPHE = re.compile(r"['’`]")
_BETWEEN_WORDS = re.compile(r"[\s!-/:-@\[-`{-~‐-―“”]+")
_BETWEEN_NAMES = re.compile(r"[,;/]")
_REMARK = re.compile(r"[\s_]*[(\[][^()\[\]]*[)\]]\s*$")
_BEFORE_DIGITS = re.compile(r"[^\d]{2,}(?=\d)")

# Last words of COCO's and NYU's catch-all classes: ``cabinet-merged``, ``table-other``.
_CATCH_ALLS = frozenset(["merged", "other", "stuff"])
# Words before an instance's number: ``chair no. 4``.
_NUMBERED = frozenset(["id", "instance", "no", "nr", "number"])
# What stands before one of these is the thing.
_PREPOSITIONS = frozenset(
    [
        "above", "against", "at", "behind", "below", "beside", "by", "for", "from", "in", "near",
        "next", "of", "on", "over", "under", "with", "without",
    ]
)  # fmt: skip
# These belong to their preposition: a built-in oven is an oven.
_VERBS = frozenset(["built", "clip", "drop", "lift", "plug", "pull", "roll", "slip", "walk"])
# Of an amount of things, the things: ``pile of books``, ``bar of soap``.
_AMOUNTS = frozenset(
    [
        "ball", "bar", "bunch", "bundle", "collection", "group", "heap", "loaf", "pair", "piece",
        "pile", "roll", "row", "set", "sheet", "slice", "stack", "strip",
    ]
)  # fmt: skip
_NEGATIONS = frozenset(["no", "non", "not"])
_TOY = "toy"
# Compounds that are not what their last word says, or not in such a place: most are what the lists
# of LVIS, Objects365 and Open Images hold.
_NO_SUCH_THING = frozenset(
    [
        "air balloon", "bottle cap", "brake light", "business card", "cabin car", "candy bar",
        "cat bed", "chain mail", "chocolate bar", "chopping board", "cutting board", "dirt bike",
        "diving board", "dog bed", "elevator car", "flower bed", "freight car", "game board",
        "golf cart", "gravy boat", "guinea pig", "home plate", "horizontal bar", "hot dog",
        "identity card", "ironing board", "license plate", "nail file",
        "peanut butter", "pet bed", "pipe bowl", "power plant", "power shovel", "railroad car",
        "river bed", "sea horse", "sea lion", "seat belt", "skirting board", "street light",
        "tea bag", "tobacco pipe", "toilet paper", "traffic light", "truck bed", "water scooter",
        "wet suit", "zip tie",
    ]
)  # fmt: skip


class NameReader:
    """Reads the names that robots give to objects. Threads may share one.

    Parameters
    ----------
    names : every name that is read as it stands, normalised → the object, and how it is named
    """

    def __init__(self, names: Mapping[str, Name]) -> None:
        self.names = names
        self._nearest = lru_cache(_SUGGESTED)(self._compare)

    def read(self, given: str) -> Name | None:
        """The object that a name stands for, and how it was read; ``None`` for an unknown name.

        ``how`` is ``label``, ``plural`` or ``synonym`` for a name of the label space as it stands,
        ``spelling`` or ``compound`` otherwise.
        """
        if (found := self.names.get(given)) is not None:
            return found
        if (found := self.names.get(normalise(given))) is not None:
            return Name(found.label, SPELLING)
        if len(given) > _LONGEST:
            return None
        if label := self._spelled(_words(given)):
            return Name(label, SPELLING)
        for part in _BETWEEN_NAMES.split(_REMARK.sub("", given) or given):
            if (found := self._read_words(_words(part))) is not None:
                return found
        return None

    def nearest(self, given: str, most: int = 3) -> list[str]:
        """The known names that are spelled most like an unknown one, one per object, best first.

        For people only: it compares with every name.
        """
        spelled = " ".join(_words(given[:_LONGEST]))
        return list(self._nearest(spelled)[:most]) if len(spelled) <= _LONGEST_COMPARED else []

    def _compare(self, spelled: str) -> tuple[str, ...]:
        close = difflib.get_close_matches(spelled, self.names, 20, _LEAST_RATIO)
        by_label: dict[str, str] = {}
        for name in close:
            by_label.setdefault(self.names[name].label, name)
        return tuple(by_label.values())

    def _read_words(self, words: Sequence[str]) -> Name | None:
        shorter = list(_without_instance(words))
        for fewer in shorter:
            if label := self._spelled(fewer):
                return Name(label, SPELLING)
        for fewer in shorter:
            if label := self._tail(fewer):
                return Name(label, COMPOUND)
        return None

    def _spelled(self, words: Sequence[str]) -> str | None:
        """The label that these words name, put apart or together."""
        return self._index.labels.get(" ".join(words)) or self._index.labels.get("".join(words))

    @cached_property
    def _index(self) -> _Index:
        """Made for the first name that is not read as it stands."""
        return _Index.of(self.names)

    def _tail(self, words: Sequence[str]) -> str | None:
        """The label of the longest known tail that begins before a preposition."""
        first = _preposition(words)
        for start in range(max(1, len(words) - self._index.most_words), first):
            tail = words[start:]
            label = self._spelled(tail) if len("".join(tail)) > 1 else None
            if label:
                return self._meant(words[:start], tail, label)
        if first == len(words):
            return None
        amount = words[first] == "of" and words[first - 1] in _AMOUNTS
        found = self._read_words(words[first + 1 :] if amount else words[:first])
        return found and found.label

    def _meant(self, before: Sequence[str], tail: Sequence[str], label: str) -> str | None:
        """The label of a tail, unless what stands before it changes what it means."""
        if _TOY in before:
            return self._index.labels.get(_TOY)
        last = before[-1]
        named = {f"{last} {' '.join(tail)}", f"{last} {label}"}  # the latter for a plural
        if last in _NEGATIONS or not named.isdisjoint(_NO_SUCH_THING):
            return None
        return label


class _Index(NamedTuple):
    """Known names taken into words.

    Attributes
    ----------
    labels : the words of a name with and without spaces between them → label
    most_words : of one name
    """

    labels: Mapping[str, str]
    most_words: int

    @classmethod
    def of(cls, names: Mapping[str, Name]) -> _Index:
        apart: dict[str, str] = {}
        together: dict[str, str] = {}
        most_words = 1
        for name, found in sorted(names.items(), key=_claim):
            words = _words(name)
            apart.setdefault(" ".join(words), found.label)
            together.setdefault("".join(words), found.label)
            most_words = max(most_words, len(words))
        labels = together | apart
        labels.pop("", None)  # names of punctuation alone are read as they stand only
        return cls(labels, most_words)


def _claim(named: tuple[str, Name]) -> tuple[int, str, str]:
    name, found = named
    return _CLAIMS.get(found.how, len(_CLAIMS)), found.label, name


def _words(text: str) -> list[str]:
    """The words of a name, in lower case: ``TVStand_2`` → ``tv``, ``stand``, ``2``."""
    apart = _HUMP.sub(" ", unicodedata.normalize("NFKC", text))
    plain = _APOSTROPHE.sub("", apart.casefold())
    return [word for word in _BETWEEN_WORDS.split(plain) if word]


def _without_instance(words: Sequence[str]) -> Iterator[Sequence[str]]:
    """The words, then fewer and fewer of those at the end that tell instances apart."""
    if words:
        yield words
    while len(words) > 0:
        last = words[-1]
        if any(map(str.isdigit, last)):
            if letters := _BEFORE_DIGITS.match(last):
                yield [*words[:-1], letters[0]]
            words = words[:-1]
            if words and words[-1] in _NUMBERED:
                yield words
                words = words[:-1]
        elif last in _CATCH_ALLS:
            words = words[:-1]
        else:
            return
        if words:
            yield words


def as_spoken(given: str) -> str:
    """An unknown name as a sentence says it, without what tells instances apart."""
    spelled = normalise(given)
    if len(given) > _LONGEST:
        return spelled
    words = _words(given)
    *_, fewest = words, *_without_instance(words)
    return spelled if fewest == words and not _HUMP.search(given) else " ".join(fewest)


def _preposition(words: Sequence[str]) -> int:
    """Where the first preposition is that something stands before; behind the last word if none."""
    for at, word in enumerate(words):
        if at and word in _PREPOSITIONS and words[at - 1] not in _VERBS:
            return at
    return len(words)
