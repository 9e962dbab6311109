import json
from itertools import combinations
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.config import load_labels
from roomtables.errors import ConfigError
from roomtables.offline.combinations import (
    Asked,
    all_combinations,
    check_key_size,
    query_frames,
    resolve,
)
from roomtables.sentences import Template
from roomtables.storage.lookup import key_bits, pack_keys
from roomtables.storage.manifest import count_combinations
from support import small_space

SPACE = small_space()
BY_RANK = ["toilet", "bed", "stove", "sink"]


def test_mpcat40_has_7175():
    assert count_combinations(35, 3) == 7175 == 35 + comb(35, 2) + comb(35, 3)


@pytest.mark.parametrize(
    ("labels", "k", "sources", "wanted"),
    [
        ("mpcat40", 3, 2, "all"),  # 2 x 165,025 sentences
        ("mpcat40", 4, 1, "all"),  # 1,369,305
        ("mpcat40", 4, 2, "misses"),
        ("household", 1, 1, "all"),
        ("household", 3, 1, "misses"),
        ("nyuclass", 3, 1, "misses"),
    ],
)
def test_auto_is_all_up_to_two_million_sentences_over_all_sources(labels, k, sources, wanted):
    assert resolve("auto", load_labels(labels), k, sources) == wanted
    assert resolve("none", load_labels(labels), k, sources) == "none"


@given(st.integers(1, 9), st.integers(1, 4))
def test_all_combinations_are_those_of_itertools(objects, k):
    expected = {
        (*chosen, *(0,) * (k - size))
        for size in range(1, k + 1)
        for chosen in combinations(range(1, objects + 1), size)
    }
    found = [tuple(row) for row in all_combinations(objects, k).tolist()]
    assert set(found) == expected
    assert len(found) == len(expected) == count_combinations(objects, k)


@given(st.integers(1, 8).flatmap(lambda k: st.tuples(st.just(k), st.data())))
def test_keys_are_reversible_and_order_as_ranks(drawn):
    k, data = drawn
    biggest = 2 ** (63 // k) - 1
    row = st.lists(st.integers(0, min(biggest, 2**31 - 1)), min_size=k, max_size=k)
    ranks = np.array(data.draw(st.lists(row, min_size=1, max_size=20)), np.int64)
    keys = pack_keys(ranks, k)
    bits = key_bits(k)
    unpacked = [
        [key >> bits * (k - 1 - place) & (1 << bits) - 1 for place in range(k)]
        for key in keys.tolist()
    ]
    assert unpacked == ranks.tolist()
    assert [ranks.tolist()[i] for i in np.argsort(keys, kind="stable")] == sorted(ranks.tolist())


def test_what_rooms_need(tmp_path):
    rooms = [["sink", "Toilets", "ghost"], ["bed", "sink", "stove", "toilet"], [], ["ghost"]]
    path = tmp_path / "rooms.jsonl"
    lines = [json.dumps({"room_id": str(n), "objects": names}) for n, names in enumerate(rooms)]
    path.write_text("\n".join(lines))
    asked = Asked.by_file(str(path), SPACE)
    ranks = [BY_RANK.index(o.label) + 1 for o in SPACE.objects]
    assert asked.ranked("proxy", ranks, 3).tolist() == [[1, 2, 3], [1, 4, 0]]


def test_sentences_follow_the_ranks():
    ranks = np.array([[1, 4, 0]])
    by_label = {o.label: o for o in SPACE.objects}
    by_rank = [by_label[label] for label in BY_RANK]
    ((objects, before, after),) = query_frames(ranks, by_rank, Template())
    assert objects == ["toilet", "sink"]
    assert (before, after) == ("A room containing toilets and sinks is called ", ".")


def test_too_many_objects_for_a_key():
    check_key_size(127, 8)
    with pytest.raises(ConfigError, match="smaller -k"):
        check_key_size(128, 8)
