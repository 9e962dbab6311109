"""The small label space on disk, and counts for it."""

import pytest

from support import small_space, write_space

COUNTS = "object,room,count\nbed,bedroom,9\nsink,kitchen,2\nsink,bathroom,3\nstove,kitchen,4\n"


@pytest.fixture
def labels(tmp_path):
    return str(write_space(tmp_path / "labels", small_space()))


@pytest.fixture
def counts(tmp_path):
    path = tmp_path / "counts.csv"
    path.write_text(COUNTS)
    return path
