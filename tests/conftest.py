"""Fixtures that every test may use."""

from __future__ import annotations

import os

# Before torch is imported, here or in a child: the models of the tests are so small that threads
# only wait for each other, which on a busy machine takes most of the time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from pathlib import Path

import pytest
from hypothesis import settings

# Clocks of shared machines are noisy: no test is judged by its time.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real rooms and scenes beside the checkout; tests skip where it is absent."""
    root = Path(os.environ.get("ROOMTABLES_SHARED", Path(__file__).parents[2] / "shared"))
    if not (root / "data").is_dir():
        pytest.skip(f"real test data is not at {root / 'data'} (set ROOMTABLES_SHARED)")
    return root / "data"
