"""The example on the package's front page runs as it stands there."""

import doctest

import roomtables


def test_the_example_of_the_package_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(roomtables)
    assert found.attempted >= 6
    assert found.failed == 0
