"""Schedule shards of sentences on Ray's actors, one model each; Ray does nothing else.

The driver cuts what is to be scored into shard files, an actor scores a shard and writes a part
file beside it, and the driver takes the part into the cache. Actors and driver share a path. What
is missing, what is cached and what is published stays with the driver, so that the death of an
actor repeats a shard, and the death of the driver loses the shards that were under way.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from itertools import islice
from pathlib import Path
from typing import Any

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

import pyarrow as pa
import pyarrow.parquet as pq
import ray
import ray.data
from ray.exceptions import RayError
from tqdm import tqdm

from roomtables.config import BuildConfig
from roomtables.errors import ModelError, RoomtablesError
from roomtables.offline.inputs import LazyScorer
from roomtables.offline.scoring import Scored, Work, check_identity, scored
from roomtables.storage.files import writing
from roomtables.storage.score_cache import SentenceCache

# As many as the scorer's largest window: a smaller shard would share less between sentences.
SHARD_SENTENCES = 65_536


class ShardWriter:
    """An actor: one model, which scores shard after shard.

    What a user can correct comes back as a row's ``error``, in its own words: Ray would repeat the
    work and wrap the message.
    """

    def __init__(self, config: BuildConfig, model: LazyScorer, cache: SentenceCache) -> None:
        self.cache = cache
        self.failure = ""
        try:
            self.scorer = model.load()
            check_identity(self.scorer, cache)
        except RoomtablesError as error:
            self.failure = str(error)

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        """Score the shard file that the row names: sentences, tokens, and an error or none."""
        if not self.failure:
            try:
                return {**self._score(row["shard"]), "error": ""}
            except RoomtablesError as error:
                self.failure = str(error)
        return {"sentences": 0, "tokens": 0, "error": self.failure}

    def _score(self, shard: str) -> dict[str, int]:
        sentences = pq.read_table(shard).column("sentence").to_pylist()
        found = list(scored(self.scorer, iter(sentences), len(sentences)))
        scores = [score for _, score in found]
        self.cache.append([sentence for sentence, _ in found], scores)
        return {"sentences": len(scores), "tokens": sum(score.token_count for score in scores)}


def score_on_ray(work: Work) -> Scored:
    """Score table ``todo`` on the cluster that ``RAY_ADDRESS`` names, or on one of this machine.

    Raises
    ------
    ModelError, StoreError
        As in a local build; what other actors have scored is kept.
    """
    run = work.cache.run_folder()
    shards = _write_shards(work, run.folder)
    started_here = not ray.is_initialized()
    logging.getLogger("ray").setLevel(logging.ERROR)
    if started_here:
        ray.init(log_to_driver=False, configure_logging=False)
    try:
        with redirect_stdout(sys.stderr):  # Ray prints there when a worker dies
            return _run(work, run, shards)
    except RayError as error:
        said = str(error).strip().splitlines()[0]
        raise ModelError(f"Ray failed: {said}; run `roomtables build` to go on") from error
    finally:
        work.cache.end_runs()
        if started_here:
            ray.shutdown()


def _run(work: Work, run: SentenceCache, shards: list[Path]) -> Scored:
    resources, size = _actors(work.config, len(shards))
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    rows = ray.data.from_items(
        [{"shard": str(shard.resolve())} for shard in shards], override_num_blocks=len(shards)
    ).map(
        ShardWriter,
        fn_constructor_kwargs={"config": work.config, "model": work.model, "cache": run},
        compute=ray.data.ActorPoolStrategy(size=size),
        **resources,
    )
    done = Scored(workers=size)
    started = time.monotonic()
    bar = tqdm(
        total=work.total, unit="sentence", desc="scoring", disable=not work.progress, leave=False
    )
    with bar:
        for row in rows.iter_rows():
            work.cache.adopt()
            if row["error"]:
                raise ModelError(row["error"])
            done.sentences += row["sentences"]
            done.tokens += row["tokens"]
            bar.update(row["sentences"])
    done.seconds = time.monotonic() - started
    return done


def _actors(config: BuildConfig, shards: int) -> tuple[dict[str, float], int]:
    """What an actor takes of the cluster, and how many actors there are."""
    cluster = ray.cluster_resources()
    gpus = int(cluster.get("GPU", 0)) if config.device != "cpu" else 0
    workers = gpus or int(cluster.get("CPU", 1))
    resources = {"num_gpus": 1.0} if gpus else {"num_cpus": 1.0}
    return resources, max(1, min(config.workers or workers, workers, shards))


def _write_shards(work: Work, folder: Path) -> list[Path]:
    """The sentences of ``todo`` as Parquet files for the actors to read."""
    size = min(SHARD_SENTENCES, -(-work.total // (_workers_expected(work.config) * 4)))
    shards = []
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for number, sentences in enumerate(_chunks(work.sentences(), max(1, size))):
            shards.append(folder / f"shard-{number:06d}.parquet")
            pq.write_table(pa.table({"sentence": pa.array(sentences, pa.string())}), shards[-1])
    return shards


def _workers_expected(config: BuildConfig) -> int:
    """How many workers share the work, before the cluster is known."""
    return config.workers or os.cpu_count() or 1


def _chunks(sentences: Iterator[str], size: int) -> Iterator[list[str]]:
    while chunk := list(islice(sentences, size)):
        yield chunk
