"""Rooms and objects, read from ``knowledge/``; ``check_knowledge`` checks those files."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

KNOWLEDGE = Path(__file__).parent / "knowledge"

# How probable it is that a room of the kind holds the object.
TIERS = {
    "nearly_always": 0.9,
    "usually": 0.7,
    "often": 0.5,
    "sometimes": 0.2,
    "seldom": 0.1,
    "rarely": 0.05,
}
SYNONYM_SHARE = 0.2  # of an object's mentions
# Where rooms of a setting are found.
SETTINGS = {
    "home": ("house", "apartment", "flat", "home", "villa", "cottage"),
    "office": ("office building", "company", "bank", "town hall"),
    "school": ("school", "university", "college", "kindergarten"),
    "hotel": ("hotel", "guesthouse", "inn", "resort"),
    "shop": ("shopping mall", "shopping street", "town", "village"),
    "hospital": ("hospital", "clinic", "nursing home", "health center"),
    "restaurant": ("restaurant", "hotel", "shopping mall", "pub"),
    "public": ("city", "public building", "town", "museum"),
    "industrial": ("factory", "warehouse", "company", "farm"),
}


@dataclass(frozen=True)
class Room:
    """One kind of room; ``objects`` maps an object's name to its probability of being there."""

    name: str
    synonyms: tuple[str, ...]
    setting: str
    purpose: tuple[str, ...]
    description: tuple[str, ...]
    near: tuple[str, ...]
    objects: dict[str, float]
    never: tuple[str, ...]


@dataclass(frozen=True)
class Thing:
    """One kind of object."""

    name: str
    kind: str
    definition: str
    use: str
    places: tuple[str, ...]
    synonyms: tuple[str, ...]

    def called(self) -> list[tuple[str, float]]:
        """Every name of the object, with its share of the object's mentions."""
        if not self.synonyms:
            return [(self.name, 1.0)]
        share = SYNONYM_SHARE / len(self.synonyms)
        return [(self.name, 1 - SYNONYM_SHARE), *((name, share) for name in self.synonyms)]


@dataclass(frozen=True)
class Facts:
    """All rooms and all objects, by name, in the order of their files."""

    rooms: dict[str, Room]
    things: dict[str, Thing]


def load_facts(folder: Path = KNOWLEDGE) -> Facts:
    """Read ``rooms/*.toml`` and ``objects.csv`` of a knowledge folder."""
    rooms = [read_room(path) for path in sorted((folder / "rooms").glob("*.toml"))]
    with open(folder / "objects.csv", encoding="utf-8", newline="") as lines:
        things = {row["object"]: _thing(row) for row in csv.DictReader(lines)}
    return Facts({room.name: room for room in rooms}, things)


def read_room(path: Path) -> Room:
    """Read one room's file."""
    entry = tomllib.loads(path.read_text(encoding="utf-8"))
    objects: dict[str, float] = {}
    for tier, probability in TIERS.items():
        for name in entry.get(tier, []):
            objects.setdefault(name, probability)
    texts = {
        key: tuple(entry.get(key, []))
        for key in ("synonyms", "purpose", "description", "near", "never")
    }
    return Room(name=entry["room"], setting=entry["setting"], objects=objects, **texts)


def _thing(row: dict[str, str]) -> Thing:
    def parts(key: str) -> tuple[str, ...]:
        return tuple(part.strip() for part in (row[key] or "").split("|") if part.strip())

    return Thing(
        row["object"], row["kind"], row["definition"], row["use"], parts("place"), parts("synonyms")
    )
