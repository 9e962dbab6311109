"""SIGINT and SIGTERM end any command with exit code 130 and one line."""

import os
import signal
import subprocess
import sys
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


EXECUTED = """
import os, signal, sys, click
from roomtables.cli.common import Group
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.default_int_handler)
act = click.Command("act", callback=lambda: exec("os.kill(os.getpid(), signal.SIGINT)"))
Group("roomtables", commands=[act])(["act"])
"""
IMPORTING = """
import os, signal, sys
sys.argv, number = sys.argv[:1], int(sys.argv[1])
signal.signal(signal.SIGINT, signal.default_int_handler)
class Meets:
    def find_spec(self, name, *_):
        if name == "roomtables.cli.common":
            os.kill(os.getpid(), number)
sys.meta_path.insert(0, Meets())
import roomtables.cli
"""


def test_a_signal_within_executed_text_is_met_alike():
    ended = subprocess.run([sys.executable, "-c", EXECUTED], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, LINE)


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_signal_while_the_program_is_imported_is_one_line(number):
    command = [sys.executable, "-c", IMPORTING, str(int(number))]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, "interrupted\n")


def test_importing_the_command_line_leaves_the_handlers():
    code = (
        "import signal; before = signal.getsignal(2), signal.getsignal(15); import roomtables.cli; "
        "assert before == (signal.getsignal(2), signal.getsignal(15))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
