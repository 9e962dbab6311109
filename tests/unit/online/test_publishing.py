"""A writer publishes in a tight loop while readers open and classify."""

from __future__ import annotations

from publish_loop import READERS, race


def test_readers_see_whole_generations_and_no_error() -> None:
    found = race(2.0)
    assert found["wrong"] == []
    assert found["exit_codes"] == [0] * READERS
    assert found["generations_seen"] > 1
    assert found["published"] > 1
