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
    query_sentences,
)
from roomtables.offline.inputs import Inputs
from roomtables.sentences import Template
from roomtables.twin import pack_keys

_CHUNK = 4096  # combinations whose sentences are held at once


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


def create_tables(connection: duckdb.DuckDBPyConnection) -> None:
    """Empty tables ``single_sentences`` and ``queries``."""
    connection.execute(
        "create table single_sentences (object varchar, room varchar, sentence varchar)"
    )
    connection.execute(
        "create table queries (source varchar, key ubigint, objects varchar[], "
        "room_position integer, sentence varchar)"
    )


def load_queries(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """Table ``queries``: one row per source, combination and predicted room."""
    sources = connection.execute("select distinct source from entropy order by source").fetchall()
    for (source,) in sources:
        ordered = connection.execute(
            "select object from entropy where source = ? order by rank", [source]
        ).fetchall()
        by_rank = [label for (label,) in ordered]
        _load_source(connection, inputs, source, by_rank, _combinations(inputs, by_rank))


def _combinations(inputs: Inputs, by_rank: list[str]) -> Ranks:
    k = inputs.config.k
    if inputs.rooms is not None:
        ranks = {label: rank for rank, label in enumerate(by_rank, start=1)}
        return combinations_of_rooms(inputs.rooms, inputs.labels, ranks, k)
    if inputs.config.combinations == "all":
        return all_combinations(len(by_rank), k)
    return np.zeros((0, k), np.int64)


def _load_source(
    connection: duckdb.DuckDBPyConnection,
    inputs: Inputs,
    source: str,
    by_rank: list[str],
    ranks: Ranks,
) -> None:
    rooms = len(inputs.labels.predicted_rooms)
    composed = query_sentences(ranks, by_rank, inputs.labels, inputs.template)
    keyed = zip(pack_keys(ranks, inputs.config.k).tolist(), composed, strict=True)
    while chunk := list(islice(keyed, _CHUNK)):
        batch = pa.table(
            {
                "key": pa.array([key for key, _ in chunk], pa.uint64()),
                "objects": [objects for _, (objects, _) in chunk],
                "sentences": [sentences for _, (_, sentences) in chunk],
            }
        )
        connection.register("batch", batch)
        connection.execute(
            "insert into queries select ?, key, objects, unnest(range(?)), unnest(sentences) "
            "from batch",
            [source, rooms],
        )
        connection.unregister("batch")
