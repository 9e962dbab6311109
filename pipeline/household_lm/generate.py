"""Render the knowledge to running text: `python -m pipeline.household_lm.generate -o corpus.txt`.

One document per line. The same seed gives the same text. The sentence that the model is later
asked to score ("A room cont… is called …") is never written.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from functools import cache
from itertools import islice
from pathlib import Path

import click

from .facts import Facts, Room, Thing, load_facts
from .grammar import Frame, load_frames, own_words, render, slots
from .marks import Evidence, Marked, marked
from .noise import noise
from .scene import Scene
from .world import World

# How often a kind of frame is drawn. Objects before their room: that is what is asked later.
KINDS = {
    "objects_to_room": 90,
    "room_to_objects": 60,
    "rooms": 8,
    "things": 12,
    "comparisons": 8,
    "stories": 16,
}
# How often a document is of a kind: one sentence; several on one room; several on many rooms.
DOCUMENTS = {"sentence": 110, "one_room": 4, "many_rooms": 5, "walk": 3}
NOISE_SHARE = 0.6  # of sentences have words of their frame replaced
LEAD_SHARE = 0.5  # of sentences from objects to a room start from an object, drawn from all alike


class Writer:
    """Writes documents from one stream of random numbers."""

    def __init__(
        self, world: World, seed: int, mark: bool = False, noisy: float = NOISE_SHARE
    ) -> None:
        self.world, self.rng, self.mark, self.noisy = world, random.Random(seed), mark, noisy
        self.marks: list[Marked] = []

    def document(self) -> str:
        """Write one document; with ``mark``, what its marks say is then in ``marks``."""
        self.marks = []
        kind = self.rng.choices(list(DOCUMENTS), list(DOCUMENTS.values()))[0]
        return str(getattr(self, f"_{kind}")())

    def _sentence(self, room: tuple[str, Room] | None = None) -> str:
        kind = self.rng.choices(list(KINDS), list(KINDS.values()))[0]
        frame = self.rng.choice(_frames(kind))
        thing = None
        any_object = kind == "things" and _speaks_of_objects_only(kind, id(frame))
        if not room and (any_object or self._leads(kind)):
            thing = self._thing()
        marks = self.marks if self.mark and not room else None
        scene = Scene(self.world, self.rng, room, thing, kind == "comparisons", marks)
        say = str if room else self._noise(frame)
        return self._ended(render(frame, scene.fill, self.rng, say))

    def _leads(self, kind: str) -> bool:
        return kind == "objects_to_room" and self.rng.random() < LEAD_SHARE

    def _ended(self, sentence: str) -> str:
        """A sentence behind which nothing is known."""
        if not self.mark:
            return sentence
        self.marks.append(Evidence())
        return sentence + marked("")

    def _noise(self, frame: Frame) -> Callable[[str], str]:
        """What becomes of a frame's own words: nothing, or noise."""
        if self.rng.random() >= self.noisy:
            return str
        return noise(self.world.noise_words, own_words(frame), self.rng)

    def _thing(self) -> Thing:
        return self.rng.choice(self.world.placed)

    def _one_room(self) -> str:
        room = self.world.draw_room(self.rng)
        return " ".join(self._sentence(room) for _ in range(self.rng.randint(2, 5)))

    def _many_rooms(self) -> str:
        return " ".join(self._sentence() for _ in range(self.rng.randint(3, 8)))

    def _walk(self) -> str:
        lines = [self.rng.choice(_frames("walk_openings"))]
        lines += [self.rng.choice(_frames("walks")) for _ in range(self.rng.randint(2, 6))]
        marks = self.marks if self.mark else None
        return " ".join(
            self._ended(render(frame, Scene(self.world, self.rng, marks=marks).fill, self.rng))
            for frame in lines
        )


@cache
def _frames(kind: str) -> list[Frame]:
    return load_frames(kind)


@cache
def _speaks_of_objects_only(kind: str, frame_id: int) -> bool:
    frame = next(frame for frame in _frames(kind) if id(frame) == frame_id)
    return not any("home" in slot for slot in slots(frame))


def documents(facts: Facts, seed: int, noisy: float = NOISE_SHARE) -> Iterator[str]:
    """Yield documents without end; the same facts and seed give the same ones.

    ``noisy`` is the share of sentences some of whose words are replaced.
    """
    writer = Writer(World(facts), seed, noisy=noisy)
    while True:
        yield writer.document()


@click.command()
@click.option("--seed", default=0, show_default=True)
@click.option("--documents", "count", default=20_000, show_default=True)
@click.option("-o", "output", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(seed: int, count: int, output: Path) -> None:
    """Write a corpus to a text file, one document per line."""
    with output.open("w", encoding="utf-8") as out:
        out.writelines(text + "\n" for text in islice(documents(load_facts(), seed), count))


if __name__ == "__main__":
    main()
