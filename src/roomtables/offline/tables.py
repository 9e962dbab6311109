"""How each table of a version is made: one function a stage, one SELECT where there is a .sql file.

A stage is handed tables and values by :class:`Reads`, under the names that ``build.toml`` lists,
and hands on its table, with the work tables that later stages read beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import duckdb

from roomtables.config import ALL, NONE
from roomtables.errors import ConfigError, first_line
from roomtables.labels import names_of_objects
from roomtables.offline.asked_sentences import (
    PAIR,
    new_sentences,
    query_sentences,
    single_sentences,
)
from roomtables.offline.combinations import all_combinations, query_frames
from roomtables.offline.inputs import INPUTS, Inputs, PairValues
from roomtables.offline.stages import QUERIES, QUERY_SCORES, SENTENCE_SCORES, Stage, stage_sql
from roomtables.offline.workspace import Workspace, WorkTable
from roomtables.schemas import TABLE_BY_NAME, Column, identifier
from roomtables.sentences import Template
from roomtables.storage.lookup import pack_keys

_CHUNK = 65_536  # combinations that are held as Python objects at once
_FRAME = (
    Column("source", "varchar", "whose entropies ranked the objects"),
    Column("key", "ubigint", "the objects' ranks, packed"),
    Column("objects", "varchar[]", "object labels, in sentence order"),
    Column("before_room", "varchar", "what the sentence says before its room"),
    Column("after_room", "varchar", "and after it"),
)
# Work tables that a stage hands on beside its own.
_WORK_TABLES = {"single_sentences": SENTENCE_SCORES}

# Sees that a table's sentences have scores; returns the view of those scores.
Score = Callable[[WorkTable], WorkTable]


@dataclass(frozen=True)
class Reads:
    """What a stage is handed: what ``build.toml`` says it reads, and nothing else.

    Asking for anything else raises :class:`ConfigError`.
    """

    stage: Stage
    inputs: Inputs
    tables: Mapping[str, WorkTable]
    score: Score

    def value(self, name: str) -> Any:
        """A setting, or the content of an input file."""
        self._check(name)
        return self.inputs.value(name)

    def table(self, name: str) -> WorkTable:
        """A table of an earlier stage."""
        self._check(_WORK_TABLES.get(name, name))
        return self.tables[name]

    def all_tables(self) -> list[WorkTable]:
        """The tables of all the earlier stages that the stage reads."""
        reads = self.stage.reads
        return [t for name, t in self.tables.items() if _WORK_TABLES.get(name, name) in reads]

    def scores(self, sentences: WorkTable) -> WorkTable:
        """``sentence_scores``, with those of a table's sentences, which the model is asked for."""
        self._check("model")
        return self.score(sentences)

    def settings(self) -> dict[str, Any]:
        """All settings that the stage reads, by name."""
        others = INPUTS | self.tables.keys() | {"model"}
        return {name: self.inputs.value(name) for name in self.stage.reads if name not in others}

    def _check(self, name: str) -> None:
        if name not in self.stage.reads:
            raise ConfigError(
                f"build.toml: stage `{self.stage.name}` needs `{name}`; add it to what "
                f"`stages.{self.stage.name}` reads"
            )


class Tables:
    """The tables of a version in the making, by name."""

    def __init__(self, workspace: Workspace, inputs: Inputs, score: Score) -> None:
        self.workspace = workspace
        self._inputs = inputs
        self._score = score
        self._made: dict[str, WorkTable] = {}

    def __getitem__(self, name: str) -> WorkTable:
        return self._made[name]

    def reads(self, stage: Stage) -> Reads:
        """What a stage is handed."""
        return Reads(stage, self._inputs, self._made, self._score)

    def make(self, stage: Stage) -> None:
        """Make a stage's table.

        Raises
        ------
        ConfigError
            The stage needs what ``build.toml`` does not say it reads, or its SQL is wrong.
        """
        made = _MAKERS.get(stage.name, _select)(self.workspace, self.reads(stage))
        self._made = self._made | {table.name: table for table in made}


def _objects(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    objects = reads.value("objects.csv")
    labels, plurals = [o.label for o in objects], [o.plural for o in objects]
    rows = {"id": range(len(objects)), "label": labels, "plural": plurals}
    return [workspace.load("objects", TABLE_BY_NAME["objects"].columns, rows)]


def _rooms(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    rooms = reads.value("rooms.csv")
    rows = {
        "id": range(len(rooms)),
        "label": [r.label for r in rooms],
        "article": [r.article for r in rooms],
        "predicted": [r.predicted for r in rooms],
    }
    return [workspace.load("rooms", TABLE_BY_NAME["rooms"].columns, rows)]


def _names(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    names = sorted(names_of_objects(reads.value("objects.csv")).items())
    rows = {
        "name": [name for name, _ in names],
        "object": [found.label for _, found in names],
        "how": [found.how for _, found in names],
    }
    return [workspace.load("names", TABLE_BY_NAME["names"].columns, rows)]


def _sentence_scores(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    """The single-object sentences, and their scores; none where scores were imported."""
    asked = () if reads.value("scores") else reads.value("objects.csv")
    rooms, templates = reads.value("rooms.csv"), reads.value("template")
    sentences = single_sentences(workspace, asked, rooms, templates, reads.value("scored"))
    return [sentences, reads.scores(sentences)]


def _cooccurrence(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    counts = _load_pairs(workspace, "counts", "count", reads.value("counts"))
    scores = _load_pairs(workspace, "scores", "score", reads.value("scores"))
    return _select(workspace, reads, [counts, scores])


def _load_pairs(
    workspace: Workspace, name: str, number: str, pairs: PairValues | None
) -> WorkTable:
    """A table of one number per object and room; empty where there are none."""
    rows = sorted(pairs.values.items()) if pairs else []
    values = {
        "object": [object_ for (object_, _), _ in rows],
        "room": [room for (_, room), _ in rows],
        number: [value for _, value in rows],
    }
    return workspace.load(name, (*PAIR, Column(number, "double", "the number")), values)


def _queries(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    """The combinations that get a query sentence, each with the sentence around its room.

    A sentence is put together when it is read: 1.35 million combinations and 23 rooms are 31
    million sentences, too many to hold.
    """
    objects, template = reads.value("objects.csv"), Template(reads.value("template")[0])
    k, wanted, asked = reads.value("k"), reads.value("combinations"), reads.value("asked")
    queries = workspace.load(QUERIES, _FRAME, {column.name: [] for column in _FRAME})
    if wanted == NONE:
        return [queries]
    by_label = {o.label: o for o in objects}
    entropy = reads.table("entropy")
    ranked = workspace.rows(f"select source, object from {entropy} order by source, rank")
    for source in sorted({source for source, _ in ranked}):
        by_rank = [by_label[label] for found, label in ranked if found == source]
        rank_of = {o.label: rank for rank, o in enumerate(by_rank, start=1)}
        in_label_order = [rank_of[o.label] for o in objects]
        ranks = (
            all_combinations(len(by_rank), k)
            if wanted == ALL
            else asked.ranked(source, in_label_order, k)
        )
        frames = query_frames(ranks, by_rank, template)
        keyed = zip(pack_keys(ranks, k).tolist(), frames, strict=True)
        _append_frames(workspace, queries, source, keyed)
    return [queries]


def _append_frames(
    workspace: Workspace,
    queries: WorkTable,
    source: str,
    keyed: Iterable[tuple[int, tuple[list[str], str, str]]],
) -> None:
    keyed = iter(keyed)
    while chunk := list(islice(keyed, _CHUNK)):
        rows = {
            "source": [source] * len(chunk),
            "key": [key for key, _ in chunk],
            "objects": [objects for _, (objects, _, _) in chunk],
            "before_room": [before for _, (_, before, _) in chunk],
            "after_room": [after for _, (_, _, after) in chunk],
        }
        workspace.append(queries, _FRAME, rows)


def _query_scores(workspace: Workspace, reads: Reads) -> list[WorkTable]:
    queries, rooms = reads.table(QUERIES), reads.value("rooms.csv")
    sentences = query_sentences(workspace, queries, rooms, reads.value("scored"))
    scores = reads.scores(new_sentences(workspace, sentences, reads.table("single_sentences")))
    return _select(workspace, reads, [sentences, scores])


def _select(
    workspace: Workspace, reads: Reads, beside: Iterable[WorkTable] = ()
) -> list[WorkTable]:
    """The table of a stage's SELECT, a published one with its schema's types.

    The SELECT may read the tables that the stage reads, those ``beside`` them, and
    ``parameters``: one row with the settings that the stage reads.
    """
    name = reads.stage.name
    sql = stage_sql(name) or ""
    settings = reads.settings()
    selected = ", ".join(f"? as {identifier(setting)}" for setting in settings) or "null as none"
    parameters = workspace.table("parameters", f"select {selected}", list(settings.values()))
    handed = dict.fromkeys([parameters, *beside, *reads.all_tables()])
    try:
        return [workspace.select(name, sql, _columns(reads), handed)]
    except (duckdb.BinderException, duckdb.CatalogException, duckdb.ParserException) as error:
        raise ConfigError(
            f"pipeline/{name}.sql: {first_line(error)}; correct it, or what `stages.{name}` of "
            "build.toml reads"
        ) from error


def _columns(reads: Reads) -> str:
    """What is selected of a stage's SELECT: a published table's columns, with their types."""
    table = TABLE_BY_NAME.get(reads.stage.name)
    if table is None:
        return "*"
    rooms: list[str] = []
    if table.per_room:
        rooms = [room.label for room in reads.value("rooms.csv") if room.predicted]
    columns = ((identifier(column.name), column.type) for column in table.columns_for(rooms))
    return ", ".join(f"{quoted}::{type_} as {quoted}" for quoted, type_ in columns)


_MAKERS: Mapping[str, Callable[[Workspace, Reads], list[WorkTable]]] = {
    "objects": _objects,
    "rooms": _rooms,
    "names": _names,
    SENTENCE_SCORES: _sentence_scores,
    "cooccurrence": _cooccurrence,
    QUERIES: _queries,
    QUERY_SCORES: _query_scores,
}
