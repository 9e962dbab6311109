"""SIGINT and SIGTERM end any command with exit code 130 and one line."""

import os
import signal
from signal import SIGINT, SIGTERM

import click
import pytest
from click.testing import CliRunner

from roomtables.cli.common import Group

LINE = "interrupted; what is scored is kept\n"


class Finalized:
    """Sends a signal when it is collected; Python drops what is raised then."""

    def __init__(self, number):
        self.number = number

    def __del__(self):
        os.kill(os.getpid(), self.number)


def meet(number):
    os.kill(os.getpid(), number)


def in_a_finalizer(number):
    Finalized(number)


def as_another_exception(number):
    try:
        os.kill(os.getpid(), number)
    except KeyboardInterrupt:
        raise RuntimeError("Query interrupted") from None


def run(action):
    group = Group("roomtables")
    group.add_command(click.Command("act", callback=action))
    return CliRunner().invoke(group, ["act"])


@pytest.fixture
def foreground():
    """The handlers of a foreground job: a background one inherits that SIGINT is ignored."""
    before = {
        SIGINT: signal.signal(SIGINT, signal.default_int_handler),
        SIGTERM: signal.signal(SIGTERM, signal.SIG_DFL),
    }
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("foreground")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
@pytest.mark.parametrize("how", [meet, in_a_finalizer, as_another_exception])
def test_no_signal_is_lost(how, number):
    found = run(lambda: how(number))
    assert (found.exit_code, found.stderr) == (130, LINE)
    assert signal.getsignal(SIGINT) is signal.default_int_handler
    assert signal.getsignal(SIGTERM) is signal.SIG_DFL


@pytest.mark.usefixtures("foreground")
@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_signal_that_is_ignored_stays_ignored(number):
    signal.signal(number, signal.SIG_IGN)
    found = run(lambda: meet(number))
    assert (found.exit_code, found.stderr) == (0, "")


@pytest.mark.usefixtures("foreground")
def test_errors_are_errors_where_no_signal_came():
    assert isinstance(run(lambda: 1 / 0).exception, ZeroDivisionError)
