"""The sentence cache: every score a scorer ever gave, in append-only Parquet parts.

Part files are named after their content and never changed. The key is the scorer's identity (the
folder) and the exact sentence.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.errors import StoreError
from roomtables.scorer import SentenceScore

SCORES = "scores"
_SCHEMA = pa.schema(
    [
        ("scorer_id", pa.string()),
        ("sentence", pa.string()),
        ("log_prob", pa.float64()),
        ("token_count", pa.int32()),
    ]
)
NO_SCORES = (
    "select null::varchar as scorer_id, null::varchar as sentence, null::double as log_prob, "
    "null::integer as token_count where false"
)


def quote(text: str | Path) -> str:
    """A string literal of SQL."""
    return "'" + str(text).replace("'", "''") + "'"


class SentenceCache:
    """The scores of one scorer under a tables folder."""

    def __init__(self, tables: Path, scorer_id: str) -> None:
        self.scorer_id = scorer_id
        self.folder = tables / SCORES / scorer_id

    def parts(self) -> list[Path]:
        """The part files, sorted by name."""
        return sorted(self.folder.glob("part-*.parquet"))

    def select(self) -> str:
        """A SELECT of the ``sentence_scores`` that are held, one row per sentence.

        Raises
        ------
        StoreError
            A part is not a readable Parquet file.
        """
        parts = self.parts()
        for part in parts:
            _check(part)
        if not parts:
            return NO_SCORES
        files = ", ".join(quote(part) for part in parts)
        return f"select * from read_parquet([{files}])"

    def append(self, sentences: Sequence[str], scores: Sequence[SentenceScore]) -> Path:
        """Write one part, aside and then into place; returns its path."""
        table = pa.table(
            {
                "scorer_id": pa.repeat(pa.scalar(self.scorer_id), len(sentences)),
                "sentence": pa.array(sentences, pa.string()),
                "log_prob": pa.array([score.log_prob for score in scores], pa.float64()),
                "token_count": pa.array([score.token_count for score in scores], pa.int32()),
            },
            _SCHEMA,
        )
        return self._write(table)

    def evict(self, connection: duckdb.DuckDBPyConnection, needed: str) -> None:
        """Forget the sentences of the table ``needed``, so that they are scored afresh."""
        old = self.parts()
        if not old:
            return
        kept = connection.sql(
            f"select * from ({self.select()}) anti join {needed} using (sentence)"
        ).to_arrow_table()
        new = self._write(kept.cast(_SCHEMA)) if kept.num_rows else None
        for part in old:
            if part != new:
                part.unlink()

    def _write(self, table: pa.Table) -> Path:
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        content = sink.getvalue()
        path = self.folder / f"part-{hashlib.sha256(content).hexdigest()[:16]}.parquet"
        aside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with aside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(aside, path)
        except OSError as error:
            aside.unlink(missing_ok=True)
            raise StoreError(
                f"cannot write {path}: {error.strerror}; free space or choose `--tables DIR`, "
                "then run `roomtables build` again: what is scored is kept"
            ) from error
        return path


def _check(part: Path) -> None:
    try:
        schema = pq.read_schema(part)
    except (pa.ArrowException, OSError) as error:
        raise StoreError(
            f"{part} is damaged; remove it and run `roomtables build` to score its sentences again"
        ) from error
    if not schema.equals(_SCHEMA):
        raise StoreError(f"{part} has other columns than sentence_scores; remove it")
