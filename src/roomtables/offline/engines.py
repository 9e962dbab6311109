"""Where sentences are scored: in this process, or by Ray's actors. Both fill the same cache.

On Ray, the driver (the process that builds) cuts what is to be scored into shard files; an actor
(a worker process that holds one model) scores a shard and writes a part file beside it; the
driver moves the part into the cache. Driver and actors see the same file system. If an actor or
its whole host dies, another actor scores its shard; if the driver dies, the shards under way are
lost, and the next build scores them.
"""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.config import BuildConfig
from roomtables.errors import (
    ConfigError,
    ModelError,
    RoomtablesError,
    first_line,
    needing,
)
from roomtables.offline.model import LazyScorer
from roomtables.offline.scoring import (
    Scored,
    Sentences,
    Work,
    check_identity,
    score_locally,
    scored,
)
from roomtables.progress import progress_bar
from roomtables.storage.files import writing
from roomtables.storage.score_cache import SentenceCache

# As many as the scorer's largest window: sentences share no work across shards.
SHARD_SENTENCES = 65_536
# So that the last shards, which not every actor has one of, are a small part of the whole.
_SHARDS_PER_WORKER = 4
# Actors that die of one shard, or as they start, one after the other: then the build gives up.
_MOST_DEATHS = 4
_STARTING = ""  # in place of a shard
_SHARD = pa.schema([("sentence", pa.string()), ("start", pa.int32())])


def score(work: Work) -> Scored:
    """Score the missing sentences with the engine of the configuration, and append to the cache.

    Ray runs on the cluster that ``RAY_ADDRESS`` names, or else on this machine.

    Raises
    ------
    MissingExtraError
        The engine is ``ray`` and Ray is not installed.
    ConfigError
        Ray does not start.
    ModelError
        The model cannot be loaded, is another than expected, or gives scores that are not finite.
    StoreError
        A part cannot be written.
    """
    return _score_on_ray(work) if work.config.engine == "ray" else score_locally(work)


class ShardWriter:
    """An actor: holds one model and scores shard after shard.

    A :class:`RoomtablesError` is returned as ``error``: if it were raised, Ray would wrap the
    message in a report of its own.
    """

    def __init__(self, config: BuildConfig, model: LazyScorer, cache: SentenceCache) -> None:
        self.cache = cache
        self.scored = config.scored
        self.failure = ""
        try:
            self.scorer = model.load()
            check_identity(self.scorer, cache, config.scored)
        except RoomtablesError as error:
            self.failure = str(error)

    def score(self, shard: str) -> dict[str, Any]:
        """Score a shard file; returns how many sentences and tokens, and an error or ''."""
        if not self.failure:
            try:
                return {**self._scored(shard), "error": ""}
            except RoomtablesError as error:
                self.failure = str(error)
        return {"sentences": 0, "tokens": 0, "error": self.failure}

    def _scored(self, shard: str) -> dict[str, int]:
        table = pq.read_table(shard)
        asked = zip(*(column.to_pylist() for column in table.columns), strict=True)
        found = list(scored(self.scorer, Sentences(asked, len(table), self.scored)))
        scores = [score for _, score in found]
        self.cache.append([sentence for sentence, _ in found], scores)
        return {"sentences": len(scores), "tokens": sum(score.token_count for score in scores)}


def _score_on_ray(work: Work) -> Scored:
    """Score on one actor per GPU, or per CPU where there is no GPU."""
    ray = _import_ray()
    run = work.cache.run_folder()
    try:
        with redirect_stdout(sys.stderr), _cluster(ray):  # Ray prints when a worker dies
            workers, needs = _workers(work.config, ray.cluster_resources())
            shards = _write_shards(work, run.folder, workers)
            workers = min(workers, len(shards))
            actor = ray.remote(ShardWriter).options(**needs)
            rows = _rows(
                ray,
                lambda: actor.remote(work.config, work.model, run),
                [str(shard.resolve()) for shard in shards],
                workers,
            )
            return _collect(work, rows, workers)
    except ray.exceptions.RayError as error:
        raise ModelError(
            f"Ray failed: {_reason(error)}; run `roomtables build` to go on"
        ) from error
    finally:
        work.cache.end_runs()


def _rows(
    ray: Any, new_actor: Callable[[], Any], shards: Sequence[str], workers: int
) -> Iterator[dict[str, Any]]:
    """What the actors say of each shard, in the order in which they finish.

    An actor that dies is replaced, and its shard goes to whichever is free first; Ray starts the
    replacement when there is room for it, which after the loss of a host may be never.

    Raises
    ------
    ray.exceptions.RayError
        An actor raises, or one after the other dies: of the same shard, or as it starts.
    """
    waiting, left = deque(shards), len(shards)
    deaths: Counter[str] = Counter()
    idle: list[Any] = []
    busy: dict[Any, tuple[Any, str]] = {}  # what is waited for: an actor, and its shard

    def start() -> None:
        actor = new_actor()
        busy[actor.__ray_ready__.remote()] = actor, _STARTING

    for _ in range(workers):
        start()
    while left:
        while idle and waiting:
            actor, shard = idle.pop(), waiting.popleft()
            busy[actor.score.remote(shard)] = actor, shard
        (ended,), _ = ray.wait(list(busy), num_returns=1)
        actor, shard = busy.pop(ended)
        try:
            row = ray.get(ended)
        except ray.exceptions.RayActorError:
            deaths[shard] += 1
            if deaths[shard] == _MOST_DEATHS:
                raise
            waiting.extendleft([shard] if shard != _STARTING else [])
            start()
            continue
        deaths[shard] = 0
        idle.append(actor)
        if shard != _STARTING:
            left -= 1
            yield row


def _import_ray() -> Any:
    """Ray, which takes seconds to import and is an extra.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # read when Ray is imported
    with needing("`--engine ray`"):
        import ray

    logging.getLogger("ray").setLevel(logging.ERROR)  # it reports on stderr, over the progress bar
    return ray


@contextmanager
def _cluster(ray: Any) -> Iterator[None]:
    """A running Ray: the caller's own, which stays up, or one that is started and shut down.

    Raises
    ------
    ConfigError
        Ray does not start, or ``RAY_ADDRESS`` is not an address.
    """
    if ray.is_initialized():
        yield
        return
    try:
        ray.init(log_to_driver=False, configure_logging=False)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"Ray does not start: {first_line(error)}; check RAY_ADDRESS, or drop `--engine ray`"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def _workers(config: BuildConfig, cluster: Mapping[str, float]) -> tuple[int, dict[str, float]]:
    """How many actors the cluster holds, at most those asked for, and what each takes of it."""
    gpus = int(cluster.get("GPU", 0)) if config.device != "cpu" else 0
    fitting = gpus or max(1, int(cluster.get("CPU", 1)))
    needs = {"num_gpus": 1.0} if gpus else {"num_cpus": 1.0}
    return min(config.workers or fitting, fitting), needs


def _reason(error: Exception) -> str:
    """The exception an actor raised, out of Ray's report of it, or else the report's first line."""
    raised = re.search(r"^[\w.]+(Error|Exception): .*", str(error), re.MULTILINE)
    return raised.group()[:200] if raised else first_line(error)


def _write_shards(work: Work, folder: Path, workers: int) -> list[Path]:
    """The missing sentences as Parquet files for the actors to read."""
    size = min(SHARD_SENTENCES, math.ceil(work.total / (workers * _SHARDS_PER_WORKER)))
    shards: list[Path] = []
    sentences = work.sentences()
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        while chunk := list(islice(sentences, size)):
            shards.append(folder / f"shard-{len(shards):06d}.parquet")
            columns = map(pa.array, zip(*chunk, strict=True), _SHARD.types)
            pq.write_table(pa.table(list(columns), schema=_SHARD), shards[-1])
    return shards


def _collect(work: Work, rows: Iterable[Mapping[str, Any]], workers: int) -> Scored:
    """Take each shard's scores into the cache as the actors finish it.

    Raises
    ------
    ModelError
        An actor reports an error; what the others have scored is kept.
    """
    done = Scored(workers=workers)
    started = time.monotonic()
    with progress_bar(work.what, work.total, shown=work.progress, leave=False) as bar:
        for row in rows:
            work.cache.adopt()
            if row["error"]:
                raise ModelError(row["error"])
            done.sentences += row["sentences"]
            done.tokens += row["tokens"]
            bar.update(row["sentences"])
    done.seconds = time.monotonic() - started
    return done
