"""Bring the sentence cache up to what a build needs: score what is missing, part by part."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator

import duckdb
from tqdm import tqdm

from roomtables.errors import ModelError
from roomtables.offline.cache import SentenceCache
from roomtables.scorer import Scorer, SentenceScore

# A part is written when it holds this many sentences or is this old: what a killed build loses.
PART_SENTENCES = 20_000
PART_SECONDS = 60.0
_FETCH = 4096


def missing_sentences(
    connection: duckdb.DuckDBPyConnection, cache: SentenceCache, needed: str
) -> int:
    """Make table ``todo``: the distinct sentences of ``needed`` that the cache lacks, sorted.

    Sorted text is what a token trie likes best. Returns how many there are.
    """
    connection.execute(
        f"create or replace table todo as select distinct sentence from {needed} "
        f"anti join (select sentence from ({cache.select()})) using (sentence) order by sentence"
    )
    return int(connection.execute("select count(*) from todo").fetchall()[0][0])


def score_missing(
    connection: duckdb.DuckDBPyConnection,
    cache: SentenceCache,
    scorer: Scorer,
    total: int,
    progress: bool,
) -> None:
    """Score table ``todo`` with the scorer and append to the cache as parts.

    Raises
    ------
    ModelError
        The scorer's identity is not the cache's, or a score is not finite; nothing bad is kept.
    """
    if scorer.scorer_id != cache.scorer_id:
        raise ModelError(
            f"the model is {scorer.scorer_id}, expected {cache.scorer_id}; run `roomtables build`"
        )
    sentences = list_todo(connection)
    kept: list[str] = []
    scores: list[SentenceScore] = []
    started = time.monotonic()
    bar = tqdm(total=total, unit="sentence", desc="scoring", disable=not progress, leave=False)
    with bar:
        try:
            for sentence, score in scored(scorer, sentences):
                if not math.isfinite(score.log_prob):
                    raise ModelError(
                        f"{scorer.scorer_id} gives {score.log_prob} for {sentence!r}; "
                        "use another `--dtype` or `--model`"
                    )
                kept.append(sentence)
                scores.append(score)
                bar.update()
                if len(kept) >= PART_SENTENCES or time.monotonic() - started > PART_SECONDS:
                    cache.append(kept, scores)
                    kept, scores, started = [], [], time.monotonic()
        finally:  # an interrupted build keeps what it has
            if kept:
                cache.append(kept, scores)


def list_todo(connection: duckdb.DuckDBPyConnection) -> Iterator[str]:
    """The sentences of ``todo``, lazily, on a cursor of their own."""
    cursor = connection.cursor()
    cursor.execute("select sentence from todo order by sentence")
    while rows := cursor.fetchmany(_FETCH):
        for (sentence,) in rows:
            yield sentence


def scored(scorer: Scorer, sentences: Iterator[str]) -> Iterator[tuple[str, SentenceScore]]:
    """Each sentence with its score, though the scorer reads ahead of what it has answered."""
    waiting: deque[str] = deque()

    def watched() -> Iterator[str]:
        for sentence in sentences:
            waiting.append(sentence)
            yield sentence

    for score in scorer.score_stream(watched()):
        yield waiting.popleft(), score
