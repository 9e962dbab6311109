"""The command line as a user types it, on tables that a scorer without a model filled."""

from __future__ import annotations

import json
import tarfile
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from roomtables import build
from roomtables.cli import main
from support import HashScorer
from wheels import hatch

ROOT = Path(__file__).parents[2]


class Shell:
    """Runs ``roomtables`` commands in a folder."""

    def __init__(self, tables: Path) -> None:
        self.tables = tables

    def __call__(self, *args, stdin=None, code=0):
        result = CliRunner().invoke(main, [str(arg) for arg in args], input=stdin)
        said = f"{args} exited {result.exit_code}\n{result.output}"
        assert result.exit_code == code, said
        if code:
            assert "Traceback" not in result.output
            if code == 1:
                (line,) = [x for x in result.stderr.splitlines() if x.startswith("error: ")]
                assert result.stdout == ""
                return line
        return result.stdout

    def lines(self, *args, **kwargs):
        return [json.loads(line) for line in self(*args, **kwargs).splitlines()]


@pytest.fixture
def shell(tmp_path):
    return Shell(tmp_path)


@pytest.fixture(scope="session")
def published(tmp_path_factory):
    """Tables of mpcat40 where the combinations of one or two objects are held."""
    tables = tmp_path_factory.mktemp("tables")
    build(tables=tables, labels="mpcat40", scorer=HashScorer(), k=2)
    return tables


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """The source distribution, unpacked."""
    folder = tmp_path_factory.mktemp("source")
    with tarfile.open(hatch(ROOT, "sdist", tmp_path_factory.mktemp("sdist"))) as archive:
        archive.extractall(folder, filter="data")
    (unpacked,) = folder.iterdir()
    return unpacked


@pytest.fixture(scope="session")
def installed(source, tmp_path_factory):
    """The wheel that is built from the source distribution, unpacked."""
    folder = tmp_path_factory.mktemp("installed")
    with zipfile.ZipFile(hatch(source, "wheel", tmp_path_factory.mktemp("wheel"))) as archive:
        archive.extractall(folder)
    return folder
