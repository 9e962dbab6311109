"""A build on three hosts, one of which dies in the middle, publishes what a local build does."""

import pytest

from end_to_end.ray_hosts import run
from network_hosts import why_not


@pytest.mark.faults
def test_a_cluster_that_loses_a_host_builds_what_one_machine_builds(tmp_path):
    pytest.importorskip("ray")
    if reason := why_not():
        pytest.skip(reason)
    found = run(tmp_path, k=2)
    assert 0 < found.scored_by_then < found.sentences
    assert found.same_combinations
    assert found.rows == found.best_rooms_equal == 630
    assert found.furthest < 1e-3
    assert (found.sentences, found.sentences_twice) == (14_630, 0)
    assert "nothing to do" in found.again or ": 0 sentences scored" in found.again
