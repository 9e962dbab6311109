"""Commands that are killed or interrupted at any change that they make to the disk.

`make test` disturbs each at one call, in the middle; `make test-faults` at every one.
"""

from itertools import cycle, takewhile
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM

import pytest

from fault_commands import COMMANDS
from fault_points import Bench, UnavailableError


@pytest.fixture(scope="module")
def bench():
    try:
        with Bench.open() as opened:
            yield opened
    except UnavailableError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize(("name", "sent"), zip(COMMANDS, cycle([SIGKILL, SIGTERM]), strict=False))
def test_a_command_survives_a_fault(bench, name, sent):
    swept = bench.sweep(COMMANDS[name], [sent], 1)
    assert not swept.failures, "\n".join(swept.failures)
    assert swept.hit == swept.points == 1


@pytest.mark.faults
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_survives_every_fault(bench, name, record_property, capsys):
    swept = bench.sweep(COMMANDS[name], [SIGKILL, SIGTERM, SIGINT])
    record_property("swept", str(swept))
    with capsys.disabled():
        print(f"\n{swept}")
    assert not swept.failures, "\n".join(swept.failures[:3])
    assert swept.hit == swept.points


def test_a_version_is_on_the_disk_before_it_is_published(bench):
    """What a power cut leaves: no file of a version is younger than the version's last flush."""
    _, calls = bench.undisturbed(COMMANDS["first-build"])
    (published,) = (at for at, call in enumerate(calls) if call.endswith("/home/CURRENT"))
    before = [call.split(" ", 1) for call in calls[:published]]
    (moved,) = (at for at, (_, path) in enumerate(before) if Path(path).name.startswith("000001-"))
    staged = [(name, path) for name, path in before[:moved] if "/.staging-" in path]
    files = {p for name, p in staged if "write" in name} - {p for n, p in staged if n == "unlink"}
    files = {path for path in files if not path.endswith(".tmp")}
    assert len(files) > 10
    for path in files | {path.rpartition("/")[0] for path in files}:
        last = next(name for name, found in reversed(staged) if found == path)
        assert last == "fsync", path
    assert any(name == "fsync" and path.endswith("/home") for name, path in before[moved:])
    written_aside = [name for name, path in before[moved:] if ".CURRENT." in path]
    assert written_aside[-1] == "fsync"


def test_a_score_part_is_on_the_disk_before_it_has_its_name(bench):
    _, calls = bench.undisturbed(COMMANDS["first-build"])
    parts = [at for at, call in enumerate(calls) if "rename" in call and "/part-" in call]
    assert parts
    for at in parts:
        assert calls[at - 1].startswith("fsync")
        after = takewhile(lambda call: "/scores/" in call, calls[at + 1 :])
        assert any(call.startswith("fsync") for call in after)
