"""Check the knowledge files; prints counts and problems, exits with 1 if there are problems."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import Any

KNOWLEDGE = Path(__file__).parent / "knowledge"
TIERS = ("nearly_always", "usually", "often", "sometimes", "seldom", "rarely", "never")
OPTIONAL = {"usually", "seldom"}  # the tiers between: a room need not have them
LISTS = ("synonyms", "purpose", "description", "near", *TIERS)
SETTINGS = frozenset(
    {"home", "office", "school", "hotel", "shop", "hospital", "restaurant", "public", "industrial"}
)
COLUMNS = ["object", "kind", "definition", "use", "place", "synonyms"]
QUERY_FRAME = "a room containing"  # kept for the sentences that are scored, never trained on


def read_rooms() -> dict[str, dict[str, Any]]:
    """Return the content of every room file, keyed by file name."""
    paths = sorted((KNOWLEDGE / "rooms").glob("*.toml"))
    return {path.name: tomllib.loads(path.read_text(encoding="utf-8")) for path in paths}


def read_objects() -> list[dict[str, str]]:
    """Return the rows of objects.csv; raises ValueError if its header is not the agreed one."""
    with (KNOWLEDGE / "objects.csv").open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames != COLUMNS:
            raise ValueError(f"objects.csv: the header must be {','.join(COLUMNS)}")
        return list(reader)


def object_problems(rows: list[dict[str, str]]) -> list[str]:
    """Return one line per duplicate object, empty field and badly written name."""
    problems = []
    counts = Counter(row["object"] for row in rows)
    problems += [f"objects.csv: {name!r} occurs {n} times" for name, n in counts.items() if n > 1]
    for row in rows:
        where = f"objects.csv: {row['object']!r}"
        problems += [f"{where}: empty {column}" for column in COLUMNS[:-1] if not row[column]]
        if None in row or None in row.values():
            problems.append(f"{where}: wrong number of fields")
        elif row["object"] != row["object"].lower().strip():
            problems.append(f"{where}: write the name in lower case without spaces around it")
        elif row["object"] in row["synonyms"].split("|"):
            problems.append(f"{where}: is its own synonym")
    return problems


def room_problems(file: str, room: dict[str, Any], objects: set[str], rooms: set[str]) -> list[str]:
    """Return one line per problem of one room file."""
    required = {"room", "setting", *LISTS} - OPTIONAL
    wrong = (required - set(room)) | (set(room) - required - OPTIONAL)
    if wrong:
        return [f"{file}: missing or unknown keys: {', '.join(sorted(wrong))}"]
    problems = [] if room["setting"] in SETTINGS else [f"{file}: setting {room['setting']!r}?"]
    named = Counter(chain.from_iterable(room.get(tier, ()) for tier in TIERS))
    problems += [f"{file}: {name!r} is named {n} times" for name, n in named.items() if n > 1]
    problems += [f"{file}: {name!r} is not in objects.csv" for name in named if name not in objects]
    problems += [f"{file}: no room {name!r} near by" for name in room["near"] if name not in rooms]
    clashes = rooms.intersection(room["synonyms"])
    problems += [f"{file}: synonym {name!r} is a room of its own" for name in sorted(clashes)]
    problems += [f"{file}: {key} is empty" for key in LISTS if key in room and not room[key]]
    return problems


def frame_problems() -> list[str]:
    """Return one line per file that holds the frame of the query sentence."""
    paths = [KNOWLEDGE / "objects.csv", *sorted((KNOWLEDGE / "rooms").glob("*.toml"))]
    return [
        f"{path.name}: contains the query frame {QUERY_FRAME!r}"
        for path in paths
        if QUERY_FRAME in path.read_text(encoding="utf-8").lower()
    ]


def main() -> int:
    """Print counts and problems; return the exit code."""
    files, rows = read_rooms(), read_objects()
    objects = {row["object"] for row in rows}
    counts = Counter(room["room"] for room in files.values())
    problems = object_problems(rows) + frame_problems()
    problems += [f"rooms: {name!r} has {n} files" for name, n in counts.items() if n > 1]
    for file, room in files.items():
        problems += room_problems(file, room, objects, set(counts))
    used = {name for room in files.values() for tier in TIERS for name in room.get(tier, ())}
    print(f"{len(files)} rooms, {len(rows)} objects, {len(used & objects)} of them in a room file")
    for problem in problems:
        print(problem)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
