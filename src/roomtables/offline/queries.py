"""The sentences that a build needs scores of, as DuckDB tables."""

from __future__ import annotations

from itertools import islice

import duckdb
import numpy as np
import pyarrow as pa

from roomtables.labels import LabelSpace
from roomtables.offline.combinations import (
    Ranks,
    all_combinations,
    combinations_of_rooms,
    query_frames,
)
from roomtables.offline.inputs import Inputs
from roomtables.sentences import Template
from roomtables.twin import pack_keys

_CHUNK = 65_536  # combinations that are held as Python objects at once


def load_single_sentences(
    connection: duckdb.DuckDBPyConnection, labels: LabelSpace, template: Template
) -> None:
    """Table ``single_sentences``: one row per object and room, predicted or not."""
    rows = [
        (o.label, room.label, sentence)
        for o in labels.objects
        for room, sentence in zip(labels.rooms, template.compose([o], labels.rooms), strict=True)
    ]
    connection.executemany("insert into single_sentences values (?, ?, ?)", rows)


def create_tables(connection: duckdb.DuckDBPyConnection, labels: LabelSpace) -> None:
    """Empty tables ``single_sentences`` and ``combinations``, and the view ``queries``.

    A query sentence is put together when it is read: 1.35 million combinations and 23 rooms are
    31 million sentences, too many to hold.
    """
    connection.execute(
        "create table single_sentences (object varchar, room varchar, sentence varchar)"
    )
    connection.execute(
        "create table combinations (source varchar, key ubigint, objects varchar[], "
        "before_room varchar, after_room varchar)"
    )
    connection.execute("create table room_phrases (position integer, phrase varchar)")
    connection.executemany(
        "insert into room_phrases values (?, ?)",
        [(position, room.phrase) for position, room in enumerate(labels.predicted_rooms)],
    )
    connection.execute(
        "create view queries as select source, key, position as room_position, "
        "before_room || phrase || after_room as sentence from combinations cross join room_phrases"
    )


def load_queries(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """Table ``combinations``: one row per source and combination of objects."""
    sources = connection.execute("select distinct source from entropy order by source").fetchall()
    for (source,) in sources:
        ordered = connection.execute(
            "select object from entropy where source = ? order by rank", [source]
        ).fetchall()
        by_rank = [label for (label,) in ordered]
        ranks = _combinations(inputs, source, by_rank)
        _load_source(connection, inputs, source, by_rank, ranks)


def _combinations(inputs: Inputs, source: str, by_rank: list[str]) -> Ranks:
    """The combinations that the settings ask for, ``[n, k]``, as ranks of the source."""
    k = inputs.config.k
    if inputs.config.combinations == "all":
        return all_combinations(len(by_rank), k)
    rank_of = {label: rank for rank, label in enumerate(by_rank, start=1)}
    in_label_order = [rank_of[label.label] for label in inputs.labels.objects]
    asked = inputs.asked.ranked(source, in_label_order, k)
    if inputs.rooms is None:
        needed = asked
    else:
        rooms = combinations_of_rooms(inputs.rooms, inputs.labels, rank_of, k)
        needed = np.concatenate([rooms, asked])
    _, first = np.unique(pack_keys(needed, k), return_index=True)
    return needed[first]


def _load_source(
    connection: duckdb.DuckDBPyConnection,
    inputs: Inputs,
    source: str,
    by_rank: list[str],
    ranks: Ranks,
) -> None:
    frames = query_frames(ranks, by_rank, inputs.labels, inputs.template)
    keyed = zip(pack_keys(ranks, inputs.config.k).tolist(), frames, strict=True)
    while chunk := list(islice(keyed, _CHUNK)):
        batch = pa.table(
            {
                "key": pa.array([key for key, _ in chunk], pa.uint64()),
                "objects": [objects for _, (objects, _, _) in chunk],
                "before_room": [before for _, (_, before, _) in chunk],
                "after_room": [after for _, (_, _, after) in chunk],
            }
        )
        connection.register("batch", batch)
        connection.execute("insert into combinations select ?, * from batch", [source])
        connection.unregister("batch")
