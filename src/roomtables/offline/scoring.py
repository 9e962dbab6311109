"""Bring the sentence cache up to what a build needs: score what is missing, part by part."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import tee

from roomtables.config import BuildConfig
from roomtables.errors import ModelError
from roomtables.limits import FLOAT32_MAX
from roomtables.offline.model import LazyScorer
from roomtables.offline.workspace import Workspace, WorkTable
from roomtables.progress import progress_bar
from roomtables.schemas import SENTENCE
from roomtables.scorer import Scorer, SentenceScore, kept_as
from roomtables.storage.score_cache import SentenceCache

# A part is written when it holds this many sentences or is this old: what a killed build loses.
PART_SENTENCES = 20_000
PART_SECONDS = 60.0
_FETCH = 4096
# What is scored, by the table that asks for it.
_KINDS = {
    "single_sentences": "single-object sentences",
    "new_query_sentences": "query sentences",
}


@dataclass(frozen=True)
class Work:
    """What is to be scored: the distinct sentences of a table, sorted, into a cache.

    ``asked`` is the name of the table that they were asked for.
    """

    workspace: Workspace
    missing: WorkTable
    cache: SentenceCache
    model: LazyScorer
    config: BuildConfig
    total: int
    progress: bool = False
    asked: str = ""

    @property
    def what(self) -> str:
        """What the sentences are, for people."""
        return _KINDS.get(self.asked, "sentences")

    def sentences(self) -> Iterator[tuple[str, int]]:
        """The sentences, each with its start, sorted, lazily, on a cursor of their own."""
        cursor = self.workspace.connection.cursor()
        cursor.execute(f"select sentence, start from {self.missing} order by sentence")
        while rows := cursor.fetchmany(_FETCH):
            yield from rows


@dataclass
class Scored:
    """What scoring cost: sentences, scored tokens, seconds without loading a model, workers."""

    sentences: int = 0
    tokens: int = 0
    seconds: float = 0.0
    workers: int = 1

    def __add__(self, other: Scored) -> Scored:
        return Scored(
            self.sentences + other.sentences,
            self.tokens + other.tokens,
            self.seconds + other.seconds,
            max(self.workers, other.workers),
        )


def missing_sentences(workspace: Workspace, needed: WorkTable, cache: SentenceCache) -> WorkTable:
    """Of the distinct sentences of a table, each with its start, those that the cache lacks.

    They are sorted: neighbours then share the most tokens, whichever of objects and room a template
    names first.
    """
    held = f"select sentence from ({cache.select()})"
    return workspace.table(
        f"missing_{needed.name}",
        f"from {needed} anti join ({held}) using (sentence) order by sentence",
    )


def score_locally(work: Work) -> Scored:
    """Score what is missing in this process and append to the cache as parts.

    Raises
    ------
    ModelError
        The scorer's identity is not the cache's, or a score is not finite; nothing bad is kept.
    """
    scorer = work.model.load(work.progress)
    check_identity(scorer, work.cache, work.config.scored)
    shown = work.progress and not work.model.shows_progress
    bar = progress_bar(work.what, work.total, shown=shown)
    done = Scored()
    kept: list[str] = []
    scores: list[SentenceScore] = []
    started = part_started = time.monotonic()
    try:
        sentences = Sentences(work.sentences(), work.total, work.config.scored, work.what)
        for sentence, score in scored(scorer, sentences):
            kept.append(sentence)
            scores.append(score)
            done.tokens += score.token_count
            bar.update()
            if len(kept) >= PART_SENTENCES or time.monotonic() - part_started > PART_SECONDS:
                work.cache.append(kept, scores)
                done.sentences += len(kept)
                kept, scores, part_started = [], [], time.monotonic()
    finally:  # an interrupted build keeps what it has
        bar.close()
        if kept:
            work.cache.append(kept, scores)
            done.sentences += len(kept)
    done.seconds = time.monotonic() - started
    return done


def check_identity(scorer: Scorer, cache: SentenceCache, scored: str) -> None:
    """Refuse to keep one scorer's scores under another's name.

    Raises
    ------
    ModelError
        The scorer's identity is not the cache's.
    """
    found = kept_as(scorer.scorer_id, scored)
    if found != cache.scorer_id:
        raise ModelError(
            f"the model is {found}, expected {cache.scorer_id}; run `roomtables build`"
        )


class Sentences:
    """Sentences on their way to a scorer, which may read ahead of what it has answered.

    Parameters
    ----------
    asked : each sentence, and the character from which its tokens count
    total : how many there are
    scored : whether the starts matter, as in the settings
    what : the label of a scorer's progress bar
    """

    def __init__(
        self, asked: Iterable[tuple[str, int]], total: int, scored: str, what: str = "sentences"
    ) -> None:
        self._asked = iter(asked)
        self._starts: Iterator[int] | None = None
        if scored != SENTENCE:
            self._asked, again = tee(asked)
            self._starts = (start for _, start in again)
        self._total = total
        self.what = what
        self.waiting: deque[str] = deque()

    def __len__(self) -> int:
        """How many there are: what a scorer estimates the time left from."""
        return self._total

    def __iter__(self) -> Iterator[str]:
        for sentence, _ in self._asked:
            self.waiting.append(sentence)
            yield sentence

    def scores(self, scorer: Scorer) -> Iterator[SentenceScore]:
        """What a scorer says of each."""
        if self._starts is None:
            return scorer.score_stream(self)
        return scorer.score_stream(self, self._starts)


def scored(scorer: Scorer, sentences: Sentences) -> Iterator[tuple[str, SentenceScore]]:
    """Each sentence with its score.

    Raises
    ------
    ModelError
        A score is not finite.
    """
    for score in sentences.scores(scorer):
        sentence = sentences.waiting.popleft()
        if not abs(score.log_prob) <= FLOAT32_MAX:  # nor is NaN
            raise ModelError(
                f"{scorer.scorer_id} gives {score.log_prob} for {sentence!r}; "
                "use another `--dtype` or `--model`"
            )
        yield sentence, score
