"""Label space ``household``, made from the knowledge: every object, and the rooms to tell apart.

``python -m pipeline.household_lm.label_space`` writes ``pipeline/labels/household``; a test keeps
the files in step with the knowledge. The query sentence competes among the rooms here, so two rooms
that a person would name by either word are one room, under the commoner name; a room that no robot
is asked to name from its objects is left out, so that it takes nothing from the others.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from pipeline.household_lm.english import number, plural
from pipeline.household_lm.facts import Facts, load_facts

from roomtables.english import article
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel

FOLDER = Path(__file__).parents[1] / "labels" / "household"
# Names that robots use and that are read as an object of the knowledge: kinds that it does not tell
# apart, and spellings of one detector or simulator that nobody would write in a sentence.
ALSO = Path(__file__).parent / "names" / "also.csv"

ROOMS = (
    # homes
    "basement", "balcony", "bathroom", "bedroom", "children's room", "closet", "dining room",
    "entryway", "game room", "garage", "hallway", "kitchen", "laundry room", "living room",
    "music room", "nursery", "pantry", "patio", "staircase", "storage room", "utility room",
    "workshop",
    # offices and schools
    "auditorium", "cafeteria", "classroom", "conference room", "laboratory", "library", "lobby",
    "office", "server room",
    # hospitals
    "examination room", "hospital room", "operating room", "waiting room",
    # other buildings where service robots work
    "bar", "grocery store", "gym", "locker room", "museum gallery", "restaurant", "swimming pool",
    "warehouse",
)  # fmt: skip

# A room of the knowledge → the room that it is called by here, and why.
MERGED = {
    "art studio": ("workshop", "a workroom, for the arts"),
    "attic": ("storage room", "by its objects a storage room; only its place tells it"),
    "break room": ("kitchen", "an office's kitchen; only its building tells it"),
    "cafe": ("restaurant", "one is often called by the other's name"),
    "computer lab": ("classroom", "a classroom with computers; by them alone it is an office"),
    "copy room": ("office", "a room of an office; its machines stand in offices as well"),
    "dentist's office": ("examination room", "an examination room, for teeth"),
    "dining booth": ("restaurant", "a part of a restaurant"),
    "dormitory room": ("bedroom", "a bedroom; only its building tells it"),
    "dressing room": ("closet", "a walk-in closet by another name"),
    "family room": ("living room", "a synonym"),
    "guest room": ("bedroom", "a bedroom; who sleeps there is not seen"),
    "home office": ("office", "an office; only its building tells it"),
    "home theater": ("living room", "a television room by another name"),
    "hotel lobby": ("lobby", "a lobby; only its building tells it"),
    "hotel room": ("bedroom", "by its objects a bedroom; only its building tells it"),
    "janitor's closet": ("storage room", "a storage room, for cleaning"),
    "kindergarten": ("classroom", "the classroom of the youngest"),
    "lecture hall": ("auditorium", "a synonym where there are rows of seats"),
    "loading dock": ("warehouse", "a part of a warehouse"),
    "lounge": ("living room", "at home a synonym; elsewhere a room to sit in"),
    "mechanical room": ("utility room", "a synonym"),
    "meeting room": ("conference room", "a synonym"),
    "mudroom": ("entryway", "an entryway at the back of the house"),
    "open-plan office": ("office", "a large office"),
    "porch": ("patio", "both are where one sits outdoors at ground level"),
    "restaurant kitchen": ("kitchen", "a kitchen; only its building tells it"),
    "restroom": ("bathroom", "a synonym in public buildings"),
    "television room": ("living room", "a synonym"),
    "toilet": ("bathroom", "a synonym"),
    "wine cellar": ("basement", "a part of a basement"),
}

# A room of the knowledge that is no answer here → why.
LEFT_OUT = {
    "bookstore": "a shop; only a grocery store stands for shops",
    "church": "neither home nor office, and no service robot's place of work",
    "clothing store": "a shop; only a grocery store stands for shops",
    "driveway": "outdoors",
    "elevator": "a cabin with few objects, which a map tells by its doors",
    "factory floor": "an industrial robot's place of work, which its installers name",
    "garden": "outdoors",
    "hair salon": "a shop; only a grocery store stands for shops",
    "pharmacy": "a shop; only a grocery store stands for shops",
    "sauna": "rare, and known by its heat more than by its objects",
    "spa": "rare; towels, water and plants are more often a bathroom's or a pool's",
    "sunroom": "by its objects a living room or a patio",
}

# Common names of rooms that the knowledge does not list as synonyms.
MORE_SYNONYMS = {
    "bathroom": ("wc",),
    "bedroom": ("primary bedroom",),
    "closet": ("wardrobe room",),
    "entryway": ("entrance way",),
    "hallway": ("passage way",),
    "laundry room": ("utility closet",),
}


def other_names(path: Path = ALSO) -> dict[str, set[str]]:
    """The further names of each object, from a CSV of `name`, `object`, `why`."""
    names: dict[str, set[str]] = defaultdict(set)
    with path.open(encoding="utf-8", newline="") as lines:
        for row in csv.DictReader(lines):
            names[row["object"]].add(row["name"])
    return dict(names)


def label_space(facts: Facts, others: Mapping[str, set[str]]) -> LabelSpace:
    """The objects and rooms of some knowledge as label space ``household``.

    ``others`` are further names of objects, by label.

    Raises
    ------
    LabelSpaceError
        Two labels claim one synonym.
    """
    objects = [
        ObjectLabel(
            thing.name,
            in_a_sentence(thing.name),
            tuple(sorted({*thing.synonyms, *others.get(thing.name, ())})),
        )
        for thing in facts.things.values()
    ]
    rooms = [
        RoomLabel(name, article(name), tuple(sorted(_room_synonyms(name, facts)))) for name in ROOMS
    ]
    return LabelSpace(FOLDER.name, tuple(objects), tuple(rooms))


def in_a_sentence(name: str) -> str:
    """The plural of what is counted; ``butter`` and ``stairs`` stay as they are."""
    return plural(name) if number(name) == "count" else name


def _room_synonyms(name: str, facts: Facts) -> set[str]:
    merged = [other for other, (room, _) in MERGED.items() if room == name]
    synonyms = {*merged, *MORE_SYNONYMS.get(name, ())}
    return synonyms.union(*(facts.rooms[room].synonyms for room in (name, *merged)))


def main() -> None:
    """Write the label space's files."""
    FOLDER.mkdir(exist_ok=True)
    for file, text in label_space(load_facts(), other_names()).csv_files().items():
        (FOLDER / file).write_text(text, encoding="utf-8")
    print(f"wrote {FOLDER}")


if __name__ == "__main__":
    main()
