"""The published tables: columns, types, keys and grain, in one place (plain data, no pyarrow)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

SCHEMA_VERSION = 2

GROUND_TRUTH = "ground_truth"
PROXY = "proxy"
SOURCES = (GROUND_TRUTH, PROXY)

QUERY = "query"
CALIBRATED = "calibrated"
POOLED = "pooled"
RULES = (QUERY, CALIBRATED, POOLED)

REDUCTIONS = ("sum", "mean")
SENTENCE, AFTER_ROOM = "sentence", "after_room"
SCORED = (SENTENCE, AFTER_ROOM)
"""Which tokens of a sentence count: all of them, or those behind the room's name."""
# Entropies closer than this are equal; the label then decides (DuckDB and numpy sum in their own
# order, and the authors' counts hold entropies less than 1e-9 apart).
ENTROPY_DECIMALS = 10


class Column(NamedTuple):
    """A column: its name, its DuckDB type, and what it holds, with its unit."""

    name: str
    type: str
    meaning: str


class Table(NamedTuple):
    """A table: one row per what, which columns, and the columns that identify a row.

    ``per_room`` is what follows the columns: one more for each predicted room, named by its label.
    """

    name: str
    grain: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    per_room: Column | None = None

    def columns_for(self, predicted_rooms: Iterable[str]) -> tuple[Column, ...]:
        """The columns of a label space's table, given the labels of its predicted rooms."""
        if self.per_room is None:
            return self.columns
        rooms = (self.per_room._replace(name=room) for room in predicted_rooms)
        return (*self.columns, *rooms)


TABLES = (
    Table(
        "objects",
        "one row per object label",
        (
            Column("id", "integer", "position among the labels, sorted, from 0"),
            Column("label", "varchar", "the object's label"),
            Column("plural", "varchar", "the plural that a sentence says"),
        ),
        ("id",),
    ),
    Table(
        "rooms",
        "one row per room label",
        (
            Column("id", "integer", "position among the labels, sorted, from 0"),
            Column("label", "varchar", "the room's label"),
            Column("article", "varchar", "a or an"),
            Column("predicted", "boolean", "false: in the distributions, never the answer"),
        ),
        ("id",),
    ),
    Table(
        "sentence_scores",
        "one row per scorer and sentence",
        (
            Column("scorer_id", "varchar", "who scored: model, tokenizer, rule, dtype, device"),
            Column("sentence", "varchar", "the exact sentence"),
            Column("log_prob", "double", "log probability in nats, summed over scored tokens"),
            Column("token_count", "integer", "how many tokens were scored"),
        ),
        ("scorer_id", "sentence"),
    ),
    Table(
        "cooccurrence",
        "one row per source, object, room",
        (
            Column("source", "varchar", "ground_truth (counts) or proxy (language model)"),
            Column("object", "varchar", "object label"),
            Column("room", "varchar", "room label, predicted or not"),
            Column("count", "double", "times seen together; null for proxy"),
            Column("score", "double", "S(o, r) in nats; null for ground_truth"),
            Column("p_room_given_object", "double", "p(room | object), sums to 1 over rooms"),
        ),
        ("source", "object", "room"),
    ),
    Table(
        "entropy",
        "one row per source, object",
        (
            Column("source", "varchar", "ground_truth or proxy"),
            Column("object", "varchar", "object label"),
            Column("entropy_nats", "double", "entropy of p(room | object), in nats"),
            Column("rank", "integer", "1 = most informative; ties go to the label first in order"),
        ),
        ("source", "object"),
    ),
    Table(
        "room_bias",
        "one row per source, predicted room",
        (
            Column("source", "varchar", "ground_truth or proxy"),
            Column("room", "varchar", "predicted room label"),
            Column("bias_nats", "double", "b: mean over objects of log softmax of S, in nats"),
        ),
        ("source", "room"),
    ),
    Table(
        "query_scores",
        "one row per source, combination of objects",
        (
            Column("source", "varchar", "whose entropies chose and ordered the objects"),
            Column("key", "ubigint", "the objects' ranks, packed, most informative first"),
            Column("objects", "varchar[]", "object labels, in sentence order"),
        ),
        ("source", "key"),
        Column("a column per predicted room", "float", "S of its query sentence, in nats"),
    ),
    Table(
        "names",
        "one row per name that a lookup can read without taking it apart",
        (
            Column("name", "varchar", "the name, in lower case"),
            Column("object", "varchar", "label of the object that it names"),
            Column("how", "varchar", "label, plural (or singular of a plural label), or synonym"),
        ),
        ("name",),
    ),
    Table(
        "misses",
        "one row per combination asked for in vain",
        (
            Column("source", "varchar", "source of the question"),
            Column("objects", "varchar[]", "object labels, in sentence order"),
            Column("times_asked", "bigint", "how often"),
            Column("last_asked", "timestamp", "when last, UTC"),
        ),
        ("source", "objects"),
    ),
    Table(
        "evaluations",
        "one row per saved evaluation, source, rule, room",
        (
            Column("evaluation", "varchar", "the name it was saved under"),
            Column("version", "varchar", "the published version that was evaluated"),
            Column("saved", "timestamp", "when, UTC"),
            Column("source", "varchar", "ground_truth or proxy"),
            Column("rule", "varchar", "the rule asked for: query, calibrated or pooled"),
            Column("room_id", "varchar", "the room's id in the room list"),
            Column("room", "varchar", "its true label, the first of several"),
            Column("predicted", "varchar", "the answer; null where there is none"),
            Column("probability", "double", "of the answer"),
            Column("objects", "varchar[]", "labels of the k objects picked, in sentence order"),
            Column("answered_by", "varchar", "table, lm or none"),
            Column("backed_off", "boolean", "true: decided by rule pooled for want of a row"),
        ),
        ("evaluation", "source", "rule", "room_id"),
    ),
)
TABLE_BY_NAME = {table.name: table for table in TABLES}
# What a version publishes: the sentence scores are shared by all label spaces, the misses are live.
VERSION_TABLES = (
    "objects", "rooms", "names", "cooccurrence", "entropy", "room_bias", "query_scores",
)  # fmt: skip
# Names that are taken: of folders under a tables folder, and of columns beside those of the rooms.
SCORES = "scores"  # the folder of sentence scores, beside those of label spaces
RESERVED_SPACES = frozenset({SCORES})
RESERVED_ROOMS = frozenset(column.name for column in TABLE_BY_NAME["query_scores"].columns)


def literal(text: object) -> str:
    """A string as SQL writes it."""
    return "'" + str(text).replace("'", "''") + "'"


def parquet(*paths: object) -> str:
    """What SQL selects from to read Parquet files, whatever stands in their paths.

    DuckDB reads a path as a pattern: `a*b/x.parquet` would be every such file of every such folder.
    """
    files = ", ".join(literal(plain_path(path)) for path in paths)
    return f"read_parquet([{files}])"


def plain_path(path: object) -> str:
    """A path in which no character stands for others when DuckDB reads it as a pattern."""
    return "".join(f"[{character}]" if character in "*?[" else character for character in str(path))


def identifier(name: str) -> str:
    """A column's or a table's name as SQL writes it, whatever stands in it."""
    return '"' + name.replace('"', '""') + '"'


def data_dictionary() -> str:
    """The data dictionary, as Markdown: `tables/README.md` is this text."""
    lines = [
        "# Tables: the data dictionary",
        "",
        f"Generated from `roomtables.schemas` (schema version {SCHEMA_VERSION}) by "
        "`python -m roomtables.schemas`.",
    ]
    for table in TABLES:
        lines += ["", f"## {table.name}", f"{table.grain}; key: {', '.join(table.key)}", ""]
        lines += ["| column | type | meaning |", "|---|---|---|"]
        columns = (*table.columns, *((table.per_room,) if table.per_room else ()))
        lines += [f"| {c.name} | {c.type} | {_cell(c.meaning)} |" for c in columns]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """A text in a cell of a Markdown table, where a bar would end the cell."""
    return text.replace("|", r"\|")


if __name__ == "__main__":
    print(data_dictionary(), end="")
