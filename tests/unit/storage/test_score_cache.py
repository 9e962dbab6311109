import duckdb
import pytest

from roomtables.errors import StoreError
from roomtables.scorer import SentenceScore
from roomtables.storage.score_cache import SentenceCache


def held(cache):
    rows = duckdb.sql(cache.select()).fetchall()
    return {sentence: (log_prob, count) for _, sentence, log_prob, count in rows}


def test_what_is_appended_is_held(tmp_path):
    cache = SentenceCache(tmp_path, "m@1")
    assert held(cache) == {}
    cache.append(["It's a 'bed'.", "b"], [SentenceScore(-1.5, 2), SentenceScore(-2.0, 1)])
    cache.append(["c"], [SentenceScore(-0.1, 7)])
    assert held(cache) == {"It's a 'bed'.": (-1.5, 2), "b": (-2.0, 1), "c": (-0.1, 7)}


def test_scorers_do_not_share(tmp_path):
    SentenceCache(tmp_path, "m@1").append(["a"], [SentenceScore(-1.0, 1)])
    assert held(SentenceCache(tmp_path, "m@2")) == {}


def test_evicting_forgets_just_what_is_asked(tmp_path):
    cache = SentenceCache(tmp_path, "m@1")
    cache.append(["a", "b"], [SentenceScore(-1.0, 1), SentenceScore(-2.0, 1)])
    cache.append(["c"], [SentenceScore(-3.0, 1)])
    connection = duckdb.connect()
    connection.execute("create table needed as select unnest(['a', 'z']) as sentence")
    cache.evict(connection, "needed")
    assert held(cache) == {"b": (-2.0, 1), "c": (-3.0, 1)}


def test_a_damaged_part_is_named(tmp_path):
    cache = SentenceCache(tmp_path, "m@1")
    part = cache.append(["a"], [SentenceScore(-1.0, 1)])
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(StoreError, match=part.name):
        cache.select()
