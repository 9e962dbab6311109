"""SQL stages: each ``pipeline/<table>.sql`` is one SELECT that is the table of its name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa

from roomtables.config import pipeline_folder
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.offline.combinations import (
    Ranks,
    all_combinations,
    combinations_of_rooms,
    query_frames,
)
from roomtables.offline.inputs import Inputs, PairValues
from roomtables.schemas import TABLE_BY_NAME
from roomtables.sentences import Template
from roomtables.storage.files import writing
from roomtables.storage.lookup import pack_keys
from roomtables.storage.score_cache import NO_SCORES, quote

_SHOWN_ROWS = 3
# Of a large machine; half the memory of a small one. docs/scale.md has what it is enough for.
_MEMORY_BYTES = 4 << 30


def stage_sql(table: str) -> str:
    """The SELECT of a stage."""
    return (pipeline_folder() / f"{table}.sql").read_text(encoding="utf-8")


def connect(workspace: Path) -> duckdb.DuckDBPyConnection:
    """A DuckDB database in a file of its own, so that big joins spill to disk."""
    connection = duckdb.connect(str(workspace / "work.duckdb"))
    connection.execute(f"set temp_directory = {quote(workspace / 'spill')}")
    connection.execute(f"set memory_limit = '{_memory_limit() >> 20} MiB'")
    # Before anything is scored, no sentence has a score.
    connection.execute(f"create view sentence_scores as {NO_SCORES}")
    return connection


def _memory_limit() -> int:
    """Bytes that DuckDB may use before it spills to disk."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(_MEMORY_BYTES, physical // 2)


@contextmanager
def interruptible(folder: Path) -> Iterator[None]:
    """Turn what DuckDB and the file system say into this package's words.

    Raises
    ------
    StoreError
        The disk is full, or a file cannot be written or read.
    KeyboardInterrupt
        A query was interrupted.
    """
    try:
        with writing(folder):
            yield
    except duckdb.InterruptException as error:
        raise KeyboardInterrupt from error
    except (duckdb.IOException, duckdb.OutOfMemoryException, duckdb.FatalException) as error:
        text = str(error).strip().splitlines()[0]
        raise StoreError(
            f"cannot build in {folder}: {text}; free some space or memory, then run "
            "`roomtables build` again: what is scored is kept"
        ) from error


def load_labels_tables(connection: duckdb.DuckDBPyConnection, labels: LabelSpace) -> None:
    """Tables ``objects`` and ``rooms``."""
    _create(connection, "objects")
    connection.executemany(
        "insert into objects values (?, ?, ?)",
        [(number, o.label, o.plural) for number, o in enumerate(labels.objects)],
    )
    _create(connection, "rooms")
    connection.executemany(
        "insert into rooms values (?, ?, ?, ?)",
        [(number, r.label, r.article, r.predicted) for number, r in enumerate(labels.rooms)],
    )


def load_pairs(
    connection: duckdb.DuckDBPyConnection, table: str, column: str, pairs: PairValues | None
) -> None:
    """A table of one number per object and room; empty where there are no pairs."""
    connection.execute(f"create table {table} (object varchar, room varchar, {column} double)")
    if pairs is not None:
        rows = [(*pair, value) for pair, value in sorted(pairs.values.items())]
        connection.executemany(f"insert into {table} values (?, ?, ?)", rows)


def load_parameters(
    connection: duckdb.DuckDBPyConnection, parameters: Mapping[str, object]
) -> None:
    """The one-row table ``parameters`` that SQL stages read their settings from."""
    columns = ", ".join(f"? as {name}" for name in parameters)
    connection.execute(f"create table parameters as select {columns}", list(parameters.values()))


def run_stage(connection: duckdb.DuckDBPyConnection, table: str) -> None:
    """Make a table from its SELECT, a published one with its schema's types."""
    published = TABLE_BY_NAME.get(table)
    columns = "*"
    if published:
        columns = ", ".join(f"{c.name}::{c.type} as {c.name}" for c in published.columns)
    connection.execute(f"create table {table} as select {columns} from (\n{stage_sql(table)}\n)")


def run_checks(connection: duckdb.DuckDBPyConnection) -> None:
    """Run every ``pipeline/checks/*.sql``; each must return no row.

    Raises
    ------
    StoreError
        A check returned rows; the message names the check and shows the first of them.
    """
    for path in sorted((pipeline_folder() / "checks").glob("*.sql")):
        rows = connection.execute(path.read_text(encoding="utf-8")).fetchmany(_SHOWN_ROWS)
        if rows:
            raise StoreError(
                f"check {path.stem} failed, so nothing is published; rows: "
                f"{'; '.join(map(str, rows))}; run `roomtables build --full-refresh`"
            )


def export(connection: duckdb.DuckDBPyConnection, table: str, folder: Path) -> int:
    """Write a table to ``<table>.parquet``, in its own order; returns its number of rows."""
    connection.execute(
        f"copy {table} to {quote(folder / f'{table}.parquet')} "
        "(format parquet, compression zstd, row_group_size 16384)"
    )
    rows = connection.execute(f"select count(*) from {table}").fetchall()
    return int(rows[0][0])


def remove_workspace(folder: Path) -> None:
    """Remove what :func:`connect` put into the folder."""
    for path in folder.glob("work.duckdb*"):
        path.unlink()
    shutil.rmtree(folder / "spill", ignore_errors=True)


def _create(connection: duckdb.DuckDBPyConnection, table: str) -> None:
    columns = ", ".join(f"{c.name} {c.type}" for c in TABLE_BY_NAME[table].columns)
    connection.execute(f"create table {table} ({columns})")


SINGLES = "select sentence from single_sentences"
QUERIES = "select sentence from queries anti join single_sentences using (sentence)"


def prepare(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """All tables that need no score: labels, counts, imported scores, single-object sentences."""
    load_labels_tables(connection, inputs.labels)
    load_pairs(connection, "counts", "count", inputs.counts)
    load_parameters(
        connection, {"reduction": inputs.config.reduction, "smoothing": inputs.smoothing}
    )
    create_tables(connection, inputs.labels)
    if inputs.scores is None:
        load_single_sentences(connection, inputs.labels, inputs.template)
    else:
        load_pairs(connection, "single_scores", "score", inputs.scores)


def derive(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """From scores of single-object sentences to the combinations that get a query sentence."""
    if inputs.scores is None:
        run_stage(connection, "single_scores")
    for table in ("cooccurrence", "entropy", "room_bias"):
        run_stage(connection, table)
    if inputs.config.combinations != "none":
        load_queries(connection, inputs)


def need(connection: duckdb.DuckDBPyConnection, sentences: str) -> int:
    """Table ``needed``: the distinct sentences of a SELECT. Returns how many there are."""
    connection.execute(
        f"create or replace temp table needed as select distinct * from ({sentences})"
    )
    return count(connection, "needed")


def count(connection: duckdb.DuckDBPyConnection, table: str) -> int:
    """Rows of a table."""
    return int(connection.execute(f"select count(*) from {table}").fetchall()[0][0])


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
