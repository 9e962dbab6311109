"""The sentence cache: every score a scorer ever gave, in append-only Parquet parts.

The key is the scorer's identity (the folder) and the exact sentence.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from copy import copy
from pathlib import Path

import duckdb
import pyarrow as pa

from roomtables.schemas import SCORES, literal, parquet
from roomtables.scorer import SentenceScore
from roomtables.storage.files import is_held, refuse_outside, writing
from roomtables.storage.score_parts import (
    FOOTER_KEY,
    PART_SCHEMA,
    Part,
    all_parts,
    live_parts,
    settle,
    write_part,
)

NO_SCORES = (
    "select null::varchar as scorer_id, null::varchar as sentence, null::double as log_prob, "
    "null::integer as token_count where false"
)
_RUN = ".run-"
# Parts with more rows than this are merged no further.
COMPACT_ROWS = 50_000_000


class SentenceCache:
    """The scores of one scorer under a tables folder."""

    def __init__(self, tables: Path, scorer_id: str) -> None:
        self.scorer_id = scorer_id
        self.folder = tables / SCORES / scorer_id
        self._generation: list[str] | None = None

    def parts(self) -> list[Part]:
        """The parts that count, by name; those of a killed build's workers too.

        Raises
        ------
        StoreError
            A part is not a readable Parquet file, or is a link out of the tables folder.
        """
        folders = [self.folder, *sorted(self.folder.glob(f"{_RUN}*"))]
        return live_parts([part for folder in folders for part in all_parts(folder)])

    def verify(self) -> None:
        """Read every part and compare it with its name.

        Raises
        ------
        StoreError
            A part is damaged; the message names it and says how to go on.
        """
        for part in self.parts():
            part.verify()

    def holds(self, recorded: Sequence[str]) -> bool:
        """Whether all parts of these names are there still, as they are or compacted."""
        parts = all_parts(self.folder)
        live = {part.name for part in live_parts(parts)}
        merged = {name for part in parts if not part.lossy for name in part.replaces}
        return live | merged >= set(recorded)

    def select(self) -> str:
        """A SELECT of the ``sentence_scores`` that are held, one row per sentence.

        Raises
        ------
        StoreError
            As :meth:`parts`.
        """
        return select_parts(self.parts())

    def append(self, sentences: Sequence[str], scores: Sequence[SentenceScore]) -> Path:
        """Write one part, aside and then into place; returns its path."""
        table = pa.table(
            {
                "scorer_id": pa.repeat(pa.scalar(self.scorer_id), len(sentences)),
                "sentence": pa.array(sentences, pa.string()),
                "log_prob": pa.array([score.log_prob for score in scores], pa.float64()),
                "token_count": pa.array([score.token_count for score in scores], pa.int32()),
            },
            PART_SCHEMA,
        )
        digest = hashlib.sha256("\n".join(sentences).encode()).hexdigest()[:16]
        footer = {"sentences": digest, "after": self._retiring()}
        return write_part(self.folder, table, footer)

    def _retiring(self) -> list[str]:
        """The parts that retired others: named in a new part, so that it gets no retired name."""
        if self._generation is None:
            self._generation = [part.name for part in all_parts(self.folder) if part.replaces]
        return self._generation

    def evict(self, connection: duckdb.DuckDBPyConnection, needed: str) -> None:
        """Forget the sentences of the table ``needed``, so that they are scored afresh."""
        if self.parts():
            kept = f"select * from ({self.select()}) anti join {needed} using (sentence)"
            self._replace(connection, kept, all_parts(self.folder), lossy=True)

    def compact(self, connection: duckdb.DuckDBPyConnection) -> tuple[int, int]:
        """Merge the parts into one, sorted, each sentence once; how many parts before and after.

        Retired files are removed at once, or by `gc` where a reader holds the folder.
        """
        small = [part for part in self.parts() if part.rows <= COMPACT_ROWS]
        large = [part for part in self.parts() if part.rows > COMPACT_ROWS]
        if len(small) < 2:
            return len(small) + len(large), len(small) + len(large)
        merged = (
            "select any_value(scorer_id) as scorer_id, sentence, any_value(log_prob) as log_prob, "
            f"any_value(token_count) as token_count from ({select_parts(small)}) "
            f"anti join ({select_parts(large)}) using (sentence) "
            "group by sentence order by sentence"
        )
        replaced = [part for part in all_parts(self.folder) if part not in large]
        self._replace(connection, merged, replaced, lossy=any(part.lossy for part in replaced))
        return len(small) + len(large), 1 + len(large)

    def remove_retired(self) -> list[str]:
        """Remove what no part counts any more, unless a reader holds the folder; their names."""
        if not self.folder.is_dir() or is_held(self.folder):
            return []
        live = {part.name for part in self.parts()}
        retired = [part for part in all_parts(self.folder) if part.name not in live]
        with writing(self.folder):
            for part in retired:
                part.path.unlink()
            for aside in self.folder.glob(".*.tmp"):
                aside.unlink()
        return [part.name for part in retired]

    def run_folder(self) -> SentenceCache:
        """A cache of its own inside the folder, for workers whose parts are adopted later."""
        inner = copy(self)
        inner.folder = self.folder.resolve() / f"{_RUN}{os.getpid()}"
        inner._generation = self._retiring()
        return inner

    def adopt(self) -> int:
        """Take over the parts that workers finished, of this build or of one that was killed.

        A worker that outlives its build finds its folder gone and can add nothing later.
        """
        adopted = 0
        for run in sorted(self.folder.glob(f"{_RUN}*")):
            refuse_outside(self.folder, run)
            for path in sorted(run.glob("part-*.parquet")):
                Part.read(path).verify()
                os.replace(path, self.folder / path.name)
                adopted += 1
        return adopted

    def end_runs(self) -> None:
        """Remove the workers' folders."""
        self.adopt()
        for run in self.folder.glob(f"{_RUN}*"):
            shutil.rmtree(run, ignore_errors=True)

    def _replace(
        self,
        connection: duckdb.DuckDBPyConnection,
        select: str,
        replaced: Sequence[Part],
        lossy: bool,
    ) -> None:
        """Write what ``select`` gives as a part that retires others, in one rename."""
        names = [part.name for part in replaced]
        said = {"replaces": names, "sentences": f"of {' '.join(names)}", "lossy": lossy}
        footer = json.dumps(said)
        aside = self.folder / f".{os.getpid()}.tmp"
        with writing(self.folder):
            try:
                connection.execute(
                    f"copy ({select}) to {literal(aside)} (format parquet, compression zstd, "
                    f"kv_metadata {{{FOOTER_KEY}: {literal(footer)}}})"
                )
                settle(aside)
                self._generation = None
            finally:
                aside.unlink(missing_ok=True)
        self.remove_retired()


def select_parts(parts: Sequence[Part]) -> str:
    """A SELECT of the rows of some parts."""
    if not parts:
        return NO_SCORES
    return f"select * from {parquet(*(part.path for part in parts))}"
