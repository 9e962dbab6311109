"""The same tables whether one process scores or Ray's actors do."""

import os
import signal
import sys

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ray_faults import WORKERS, KillsOnce, build_on_ray
from roomtables import build
from roomtables.config import BuildConfig
from roomtables.errors import ConfigError, MissingExtraError, ModelError
from roomtables.offline.engines import ShardWriter
from roomtables.offline.model import LazyScorer
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space

SENTENCES = 46  # of the label space `small` with all combinations
SINGLES = 16  # of them, of single objects


class Broken(HashScorer):
    """Has an error in place of every score."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error

    def score_stream(self, sentences):
        for _ in sentences:
            raise self.error
            yield


@pytest.fixture
def labels(tmp_path):
    return str(write_space(tmp_path / "labels", small_space()))


@pytest.fixture
def ray():
    return pytest.importorskip("ray", reason="the extra `ray` is not installed")


@pytest.fixture
def importable(monkeypatch):
    """Whatever process is started can import what this one can."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))


@pytest.fixture
def cluster(ray, importable):
    """A Ray on this machine, small and without a dashboard."""
    ray.init(
        num_cpus=WORKERS,
        include_dashboard=False,
        log_to_driver=False,
        configure_logging=False,
        object_store_memory=80 * 2**20,
    )
    yield
    ray.shutdown()


def scores(tables):
    cache = SentenceCache(tables, "hash@1")
    return sorted(duckdb.sql(f"select sentence, log_prob from ({cache.select()})").fetchall())


def parts(tables):
    return [path.name for path in SentenceCache(tables, "hash@1").folder.iterdir()]


def test_an_actor_hands_on_what_a_user_can_correct(tmp_path):
    shard = tmp_path / "shard.parquet"
    pq.write_table(pa.table({"sentence": ["A room."], "start": [0]}), shard)
    cache = SentenceCache(tmp_path, "hash@1").run_folder()
    broken = Broken(ModelError("no score"))
    for scorer, said in ((broken, "no score"), (HashScorer("x"), "expected hash@1")):
        model = LazyScorer(BuildConfig.load(), scorer)
        actor = ShardWriter(BuildConfig.load(), model, cache)
        assert said in actor.score(str(shard))["error"]
    assert not cache.folder.exists()


def test_without_ray_the_extra_is_named(tmp_path, labels, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # what an import then says is "not installed"
    with pytest.raises(MissingExtraError, match=r"roomtables\[ray\]"):
        build(tables=tmp_path / "t", labels=labels, scorer=HashScorer(), engine="ray")


@pytest.mark.usefixtures("ray")
def test_an_address_that_is_none_is_named(tmp_path, labels, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "nonsense://somewhere")
    with pytest.raises(ConfigError, match=r"Ray does not start: .*nonsense.* RAY_ADDRESS"):
        build(tables=tmp_path / "t", labels=labels, scorer=HashScorer(), engine="ray")
    assert not list(tmp_path.glob("t/scores/*/*"))


@pytest.mark.usefixtures("cluster")
@pytest.mark.parametrize(
    ("combinations", "sentences"),
    [("none", SINGLES), pytest.param("all", SENTENCES, marks=pytest.mark.slow)],
)
def test_ray_gives_what_local_gives_though_an_actor_dies(tmp_path, labels, combinations, sentences):
    tables = tmp_path / "ray"
    options = {"labels": labels, "combinations": combinations}
    scorer = KillsOnce(tmp_path / "killed", after=3)
    found = build(tables=tables, scorer=scorer, engine="ray", workers=WORKERS, **options)
    assert (tmp_path / "killed").exists()
    assert found.sentences_scored == sentences
    build(tables=tmp_path / "local", scorer=HashScorer(), **options)
    assert scores(tables) == scores(tmp_path / "local")
    assert all(name.startswith("part-") for name in parts(tables))
    assert not build(tables=tables, scorer=HashScorer(), **options).published


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_an_error_of_an_actor_ends_the_build_in_one_line(tmp_path, labels):
    for error, said in (
        (ModelError("no score"), "^no score$"),
        (ZeroDivisionError("a bug"), "^Ray failed: ZeroDivisionError: a bug; run `roomtables"),
    ):
        with pytest.raises(ModelError, match=said):
            build(tables=tmp_path / "t", labels=labels, scorer=Broken(error), engine="ray")
    assert SpaceFolder(tmp_path / "t", "small").published() is None
    assert not list(tmp_path.glob("t/scores/*/*"))


@pytest.mark.slow
@pytest.mark.usefixtures("ray", "importable")
def test_a_killed_driver_loses_only_the_shards_under_way(tmp_path, labels):
    tables = tmp_path / "t"
    # With two sentences in a shard, an actor's fifth sentence comes when it has written two shards.
    assert build_on_ray(tables, labels, tmp_path / "killed", after=5) == -signal.SIGKILL
    assert SpaceFolder(tables, "small").published() is None
    found = build(tables=tables, labels=labels, scorer=HashScorer())
    assert found.sentences_cached >= 4
    assert found.sentences_scored + found.sentences_cached == SENTENCES
    build(tables=tmp_path / "local", labels=labels, scorer=HashScorer())
    assert scores(tables) == scores(tmp_path / "local")
    assert all(name.startswith("part-") for name in parts(tables))
