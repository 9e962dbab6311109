"""The same tables whether one process scores or Ray's actors do; skipped where Ray is absent."""

import os
import sys
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from roomtables import build
from roomtables.config import BuildConfig
from roomtables.errors import ModelError
from roomtables.offline.inputs import LazyScorer
from roomtables.storage.score_cache import SentenceCache
from support import HashScorer, small_space, write_space

pytest.importorskip("ray", reason="the extra `ray` is not installed")
from roomtables.offline import ray_engine


class Broken(HashScorer):
    def score_stream(self, sentences):
        for sentence in sentences:
            raise ModelError(f"no score for {sentence!r}")
            yield


@pytest.fixture(scope="module")
def cluster():
    import ray

    folders = [str(Path(__file__).parents[2]), *sys.path]
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PYTHONPATH", os.pathsep.join(filter(None, folders)))
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()


def scores(tables):
    cache = SentenceCache(tables, "hash@1")
    return sorted(duckdb.sql(f"select sentence, log_prob from ({cache.select()})").fetchall())


def test_an_actor_hands_on_what_a_user_can_correct(tmp_path):
    shard = tmp_path / "shard.parquet"
    pq.write_table(pa.table({"sentence": ["A room."]}), shard)
    cache = SentenceCache(tmp_path, "hash@1").run_folder()
    for scorer, said in ((Broken(), "no score for 'A room.'"), (HashScorer("x"), "expected hash")):
        model = LazyScorer(BuildConfig.load(), scorer)
        actor = ray_engine.ShardWriter(BuildConfig.load(), model, cache)
        assert said in actor({"shard": str(shard)})["error"]
    assert not cache.folder.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_ray_gives_what_local_gives(tmp_path):
    labels = str(write_space(tmp_path / "labels", small_space()))
    found = build(
        tables=tmp_path / "ray", labels=labels, scorer=HashScorer(), engine="ray", workers=2
    )
    assert found.sentences_scored == 46
    build(tables=tmp_path / "local", labels=labels, scorer=HashScorer())
    assert scores(tmp_path / "ray") == scores(tmp_path / "local")
    folder = SentenceCache(tmp_path / "ray", "hash@1").folder
    assert all(path.name.startswith("part-") for path in folder.iterdir())
    assert not build(tables=tmp_path / "ray", labels=labels, scorer=HashScorer()).published
