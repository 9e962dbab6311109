"""The build's steps between the sentences: shared by `build`, which scores, and `plan`, which
counts.
"""

from __future__ import annotations

import duckdb

from roomtables.offline import queries, stages
from roomtables.offline.inputs import Inputs

SINGLES = "select sentence from single_sentences"
QUERIES = "select sentence from queries anti join single_sentences using (sentence)"


def prepare(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """All tables that need no score: labels, counts, imported scores, single-object sentences."""
    stages.load_labels_tables(connection, inputs.labels)
    stages.load_pairs(connection, "counts", "count", inputs.counts)
    stages.load_parameters(
        connection, {"reduction": inputs.config.reduction, "smoothing": inputs.smoothing}
    )
    queries.create_tables(connection, inputs.labels)
    if inputs.scores is None:
        queries.load_single_sentences(connection, inputs.labels, inputs.template)
    else:
        stages.load_pairs(connection, "single_scores", "score", inputs.scores)


def derive(connection: duckdb.DuckDBPyConnection, inputs: Inputs) -> None:
    """From scores of single-object sentences to the combinations that get a query sentence."""
    if inputs.scores is None:
        stages.run_stage(connection, "single_scores")
    for table in ("cooccurrence", "entropy", "room_bias"):
        stages.run_stage(connection, table)
    if inputs.config.combinations != "none":
        queries.load_queries(connection, inputs)


def need(connection: duckdb.DuckDBPyConnection, sentences: str) -> int:
    """Table ``needed``: the distinct sentences of a SELECT. Returns how many there are."""
    connection.execute(
        f"create or replace temp table needed as select distinct * from ({sentences})"
    )
    return count(connection, "needed")


def count(connection: duckdb.DuckDBPyConnection, table: str) -> int:
    """Rows of a table."""
    return int(connection.execute(f"select count(*) from {table}").fetchall()[0][0])
