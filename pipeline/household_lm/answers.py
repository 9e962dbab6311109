"""What a room's name should be, given the objects before it: the generator's own posterior.

A document holds one name, drawn from p(room | objects). Training against that distribution
instead of the drawn name has the same expected gradient and less variance.
"""

from __future__ import annotations

import re
from functools import cache

import numpy as np
from numpy.typing import NDArray
from tokenizers import Tokenizer

from . import english
from .scene import MARKS, Answer
from .world import World

_UNNAMED = 0.004  # how typical an object is of a room whose file does not name it
_MARK = re.compile(f"{MARKS[0]}([^{MARKS[1]}]*){MARKS[1]}")

Target = tuple[int, NDArray[np.int64], NDArray[np.float32]]  # token's place, tokens, probabilities


class Posterior:
    """p(first token of the room's name | objects), for every form that a name takes."""

    def __init__(self, world: World, tokenizer: Tokenizer) -> None:
        self.world, self.tokenizer = world, tokenizer
        rooms = list(world.facts.rooms.values())
        self._things = {name: index for index, name in enumerate(world.facts.things)}
        typical = np.full((len(self._things), len(rooms)), _UNNAMED)
        for column, room in enumerate(rooms):
            for name, probability in room.objects.items():
                typical[self._things[name], column] = probability
            typical[:, column] /= sum(room.objects.values())
        names = [name for name, _ in world.names]
        of_room = np.array([rooms.index(room) for _, room in world.names])
        self._log = np.log(typical)[:, of_room]
        self._prior = np.log(np.array(world.name_weights))
        self._names = {name: index for index, name in enumerate(names)}
        self._has_an = np.array([english.with_article(name).startswith("an ") for name in names])

    def targets(self, marked: str, answers: list[Answer]) -> tuple[list[int], list[Target]]:
        """Encode a marked text; give its ids, and for each answer what its first token may be."""
        text = _MARK.sub(r"\1", marked)
        encoding = self.tokenizer.encode(text)
        found = []
        for number, (match, answer) in enumerate(zip(_MARK.finditer(marked), answers, strict=True)):
            token = encoding.char_to_token(match.start() - 2 * number)
            target = self._object(answer) if answer.room else self._room(answer)
            if token and encoding.ids[token] in target[0]:
                found.append((token, *target))
        return encoding.ids, found

    def _object(self, answer: Answer) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        things, shares, tokens, place = self._objects_of(answer.room or "", answer.form)
        told = [self._things[name] for name in answer.told]
        share = np.where(np.isin(things, told), 0.0, shares)
        summed = np.bincount(place, share / share.sum(), minlength=len(tokens))
        return tokens, summed.astype(np.float32)

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _objects_of(
        self, room: str, form: str
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Every name of a room's objects: its object, share, and first token."""
        found = [
            (self._things[name], typical * share, called)
            for name, typical in self.world.facts.rooms[room].objects.items()
            for called, share in self.world.facts.things[name].called()
            if form in ("bare", "plural") or english.with_article(called) == f"{form} {called}"
        ]
        forms = [english.plural(name) if form == "plural" else name for _, _, name in found]
        first = [self.tokenizer.encode(f" {name}").ids[1] for name in forms]
        tokens, place = np.unique(np.array(first, dtype=np.int64), return_inverse=True)
        things = np.array([thing for thing, _, _ in found], dtype=np.int64)
        return things, np.array([share for _, share, _ in found]), tokens, place

    def _room(self, answer: Answer) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        told = self._log[[self._things[name] for name in answer.told]].sum(0) + self._prior
        if answer.form == "a":
            fits = self._has_an == self._has_an[self._names[answer.name]]
            told = np.where(fits, told, -np.inf)
        share = np.exp(told - told.max())
        tokens, place = self._first_tokens(answer.form == "plural")
        summed = np.bincount(place, share / share.sum(), minlength=len(tokens))
        return tokens, summed.astype(np.float32)

    @cache  # noqa: B019 - one Posterior lives as long as the training
    def _first_tokens(self, plural: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        forms = [english.plural(name) if plural else name for name in self._names]
        first = [self.tokenizer.encode(f" {form}").ids[1] for form in forms]
        tokens, place = np.unique(np.array(first, dtype=np.int64), return_inverse=True)
        return tokens, place
