"""What a text's next names should be, given what it has told: the knowledge's own posterior.

Where a name stands, the model is trained against the knowledge's posterior (`bayes.py`), not the
name that was drawn: drawing only chooses the texts. Everywhere else behind the first object it is
trained on the *ratios* between rooms' names (behind a room: between its objects' names), so that
what it knows of them does not depend on the words of a sentence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from tokenizers import Encoding, Tokenizer

from . import english
from .bayes import log_presence
from .marks import MARKED, Answer, Evidence, Marked
from .world import World

Floats = NDArray[np.float32]
Tokens = NDArray[np.int64]


@dataclass(frozen=True)
class Target:
    """What the token at ``place`` may be: tokens and their probabilities."""

    place: int
    tokens: Tokens
    shares: Floats


@dataclass(frozen=True)
class Document:
    """A text's token ids, its answers, and what is known behind the tokens of other places.

    ``rooms`` and ``objects`` map a place to probabilities of what might be named next: first
    tokens of rooms (in the order of :attr:`Posterior.room_tokens`), of objects
    (:attr:`Posterior.object_tokens`).
    """

    ids: list[int]
    answers: list[Target]
    rooms: dict[int, Floats]
    objects: dict[int, Floats]

    def cut(self, length: int) -> Document:
        """The first so many tokens."""
        return Document(
            self.ids[:length],
            [target for target in self.answers if target.place < length],
            {place: shares for place, shares in self.rooms.items() if place < length},
            {place: shares for place, shares in self.objects.items() if place < length},
        )


class Posterior:
    """p(a room's name | objects) and p(an object's name | room), by tokens."""

    def __init__(self, world: World, tokenizer: Tokenizer) -> None:
        self.world, self.tokenizer = world, tokenizer
        rooms = list(world.facts.rooms.values())
        self._things = {name: index for index, name in enumerate(world.facts.things)}
        names = [name for name, _ in world.names]
        of_room = np.array([rooms.index(room) for _, room in world.names])
        self._log = log_presence(world.facts)[:, of_room]
        self._prior = np.log(np.array(world.name_weights))
        self._names = {name: index for index, name in enumerate(names)}
        self._has_an = np.array([english.with_article(name).startswith("an ") for name in names])
        first = [ids[0] for ids in self._spelled(False)]
        self.room_tokens, self._room_place = np.unique(first, return_inverse=True)
        first = [self._ids(english.plural(name))[0] for name in self._things]
        self.object_tokens, self._object_place = np.unique(first, return_inverse=True)
        self._articles = np.array([self._ids("a")[0], self._ids("an")[0]], dtype=np.int64)

    def document(self, text: str, marks: list[Marked]) -> Document:
        """Encode a marked text, and work out what its marks say of its tokens."""
        encoding = self.tokenizer.encode(MARKED.sub(r"\1", text))
        found = Document(encoding.ids, [], {}, {})
        behind = Evidence()
        at = 0
        for number, (match, mark) in enumerate(zip(MARKED.finditer(text), marks, strict=True)):
            start, end = match.start() - 2 * number, match.end() - 2 * number - 2
            last = _token_at(encoding, end - 1)
            self._known(found, behind, at, last)
            for target in self._answers(encoding, mark, start, last):
                found.answers.append(target)
                found.rooms.pop(target.place, None)
                found.objects.pop(target.place, None)
            behind, at = (mark.then if isinstance(mark, Answer) else mark), last + 1
        return found

    def _known(self, found: Document, evidence: Evidence, start: int, end: int) -> None:
        """Note what is known before the tokens from ``start`` to ``end``, less the answers."""
        if evidence.room:
            shares = self._shares_of_objects(evidence)
            found.objects.update(dict.fromkeys(range(start, end + 1), shares))
        elif evidence.told:
            shares = self._shares_of_rooms(evidence.told)
            found.rooms.update(dict.fromkeys(range(start, end + 1), shares))

    def _shares_of_rooms(self, told: tuple[str, ...]) -> Floats:
        share = np.exp(self._log_share(told))
        summed = np.bincount(self._room_place, share / share.sum(), len(self.room_tokens))
        return summed.astype(np.float32)

    def _shares_of_objects(self, evidence: Evidence) -> Floats:
        things, shares = self._typical(evidence.room or "")
        share = np.where(np.isin(things, [self._things[n] for n in evidence.told]), 0.0, shares)
        place = self._object_place[things]
        summed = np.bincount(place, share / share.sum(), len(self.object_tokens))
        return summed.astype(np.float32)

    def _log_share(self, told: tuple[str, ...]) -> NDArray[np.float64]:
        """Log p(name | objects) of every name of a room, less its greatest."""
        things = [self._things[name] for name in dict.fromkeys(told)]
        share: NDArray[np.float64] = self._log[things].sum(0) + self._prior
        return share - share.max()

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _typical(self, room: str) -> tuple[Tokens, NDArray[np.float64]]:
        objects = self.world.facts.rooms[room].objects
        things = np.array([self._things[name] for name in objects], dtype=np.int64)
        return things, np.array([*objects.values()])

    def _answers(self, encoding: Encoding, mark: Marked, start: int, last: int) -> list[Target]:
        first = encoding.char_to_token(start)
        if not first or not isinstance(mark, Answer):
            return []
        if mark.room:
            tokens, shares = self._object(mark)
            fits = encoding.ids[first] in tokens
            return [Target(first, tokens, shares)] if fits else []
        return self._name(encoding.ids, mark, first, last)

    def _object(self, answer: Answer) -> tuple[Tokens, Floats]:
        things, shares, tokens, place = self._objects_of(answer.room or "", answer.form)
        told = [self._things[name] for name in answer.told]
        share = np.where(np.isin(things, told), 0.0, shares)
        summed = np.bincount(place, share / share.sum(), minlength=len(tokens))
        return tokens, summed.astype(np.float32)

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _objects_of(
        self, room: str, form: str
    ) -> tuple[Tokens, NDArray[np.float64], Tokens, Tokens]:
        """Every name of a room's objects: its object, share, and first token."""
        found = [
            (self._things[name], typical * share, called)
            for name, typical in self.world.facts.rooms[room].objects.items()
            for called, share in self.world.facts.things[name].called()
            if form in ("bare", "plural") or english.with_article(called) == f"{form} {called}"
        ]
        first = [self._ids(english.plural(n) if form == "plural" else n)[0] for _, _, n in found]
        tokens, place = np.unique(np.array(first, dtype=np.int64), return_inverse=True)
        things = np.array([thing for thing, _, _ in found], dtype=np.int64)
        return things, np.array([share for _, share, _ in found]), tokens, place

    def _name(self, ids: list[int], answer: Answer, first: int, last: int) -> list[Target]:
        """Targets for a room's name: its article, its first token, and those behind it."""
        share = np.exp(self._log_share(answer.told))
        found = []
        if answer.form == "a" and ids[first - 1] in self._articles:
            an = share[self._has_an].sum() / share.sum()
            found.append(Target(first - 1, self._articles, np.array([1 - an, an], np.float32)))
            share = np.where(self._has_an == self._has_an[self._names[answer.name]], share, 0.0)
        for place in range(first, last + 1):
            names, tokens, at = self._next_tokens(answer.form == "plural", *ids[first:place])
            if ids[place] not in tokens:
                break
            summed = np.bincount(at, share[names] / share[names].sum(), len(tokens))
            found.append(Target(place, tokens, summed.astype(np.float32)))
        return found

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _next_tokens(self, plural: bool, *before: int) -> tuple[Tokens, Tokens, Tokens]:
        """The names that begin with some tokens, their next tokens, and which name has which.

        None where a name ends there: what follows is then the sentence's.
        """
        spelled = self._spelled(plural)
        fits = [n for n, ids in enumerate(spelled) if ids[: len(before)] == before]
        if any(len(spelled[name]) == len(before) for name in fits):
            fits = []
        names = np.array(fits, dtype=np.int64)
        following = np.array([spelled[name][len(before)] for name in fits], dtype=np.int64)
        tokens, at = np.unique(following, return_inverse=True)
        return names, tokens, at

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _spelled(self, plural: bool) -> list[tuple[int, ...]]:
        """The tokens of every name of a room, as behind a space."""
        forms = [english.plural(name) if plural else name for name in self._names]
        return [tuple(self._ids(form)) for form in forms]

    def _ids(self, words: str) -> list[int]:
        """Tokens of words behind a space, without BOS."""
        return list(self.tokenizer.encode(f" {words}").ids[1:])


def _token_at(encoding: Encoding, character: int) -> int:
    """The token of a character, or of the one before it that has a token."""
    while character >= 0:
        token = encoding.char_to_token(character)
        if token is not None:
            return int(token)
        character -= 1
    return 0
