"""The tables of sentences that a build asks a language model about, and from where each is scored.

Column ``start`` is the character from which tokens of a sentence are scored.
"""

from __future__ import annotations

from collections.abc import Sequence

from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.offline.workspace import Workspace, WorkTable
from roomtables.schemas import SENTENCE, Column
from roomtables.sentences import Template

PAIR = (Column("object", "varchar", "object label"), Column("room", "varchar", "room label"))
_SINGLE = (
    *PAIR,
    Column("template", "integer", "the number of the template, from 0"),
    Column("sentence", "varchar", "the sentence"),
    Column("start", "integer", "the character from which tokens are scored"),
)
_PHRASE = (Column("room", "varchar", "room label"), Column("phrase", "varchar", "with its article"))


def single_sentences(
    workspace: Workspace,
    objects: Sequence[ObjectLabel],
    rooms: Sequence[RoomLabel],
    templates: Sequence[str],
    scored: str,
) -> WorkTable:
    """One row per object, room and template: its sentence."""
    worded = [(n, Template(text), o) for n, text in enumerate(templates) for o in objects]
    whole = [0] * len(rooms)
    rows = {
        "object": [o.label for _, _, o in worded for _ in rooms],
        "room": [r.label for _ in worded for r in rooms],
        "template": [number for number, _, _ in worded for _ in rooms],
        "sentence": [text for _, template, o in worded for text in template.compose([o], rooms)],
        "start": [n for _, template, _ in worded for n in template.starts(rooms, scored) or whole],
    }
    return workspace.load("single_sentences", _SINGLE, rows)


def query_sentences(
    workspace: Workspace, queries: WorkTable, rooms: Sequence[RoomLabel], scored: str
) -> WorkTable:
    """A view of one row per source, combination and predicted room: its query sentence."""
    predicted = [room for room in rooms if room.predicted]
    rows = {"room": [r.label for r in predicted], "phrase": [r.phrase for r in predicted]}
    phrases = workspace.load("room_phrases", _PHRASE, rows)
    start = "0" if scored == SENTENCE else "length(before_room || phrase)"
    return workspace.view(
        "query_sentences",
        "select source, key, room, before_room || phrase || after_room as sentence, "
        f"{start} as start from {queries} cross join {phrases}",
    )


def new_sentences(workspace: Workspace, sentences: WorkTable, singles: WorkTable) -> WorkTable:
    """Of some query sentences, those that are no single-object sentences."""
    return workspace.view(
        f"new_{sentences.name}",
        f"select sentence, start from {sentences} anti join {singles} using (sentence)",
    )
