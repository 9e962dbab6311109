"""Which published tables are meant where nothing is said."""

import shutil
from pathlib import Path

import pytest

from roomtables import build
from roomtables.config import load_labels
from roomtables.errors import LabelSpaceError, StoreError
from roomtables.labels import LabelSpace
from roomtables.offline.plan import plan
from roomtables.storage.spaces import find_labels, find_space, published_labels
from roomtables.storage.versions import CURRENT, SpaceFolder
from tiny_tables import FitScorer, build_tables


@pytest.fixture
def publish(tmp_path):
    def names(*labels):
        for name in labels:
            (tmp_path / name).mkdir(parents=True)
            (tmp_path / name / CURRENT).touch()
        return tmp_path

    return names


@pytest.mark.parametrize(
    ("published", "found"),
    [
        ((), "household"),
        (("mpcat40",), "mpcat40"),
        (("household",), "household"),
        (("household", "mpcat40"), "household"),
    ],
)
def test_household_else_the_only_one(publish, published, found):
    tables = publish(*published)
    assert published_labels(tables) == published
    assert find_space(tables).labels == found


def test_of_several_others_none_is_guessed(publish):
    with pytest.raises(StoreError, match=r"mpcat40, mylabels; .*--labels"):
        find_space(publish("mpcat40", "mylabels"))


def test_what_is_named_is_taken_and_a_folder_stands_for_its_name(publish):
    tables = publish("mpcat40", "household")
    assert find_space(tables, "mpcat40").labels == "mpcat40"
    assert find_space(tables, "some/where/mpcat40").path == tables / "mpcat40"


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder to work in: the label space ``flat``, its tables, and a folder called mpcat40."""
    build_tables(tmp_path)
    shutil.copytree(tmp_path / "flat", tmp_path / "mpcat40")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_bare_name_is_the_built_in_space_and_a_path_the_folder(site):
    tables = Path("tables")
    assert len(find_labels("mpcat40", tables).objects) == 35
    for folder in ("./mpcat40", "mpcat40/", str(site / "mpcat40")):
        assert len(find_labels(folder, tables).objects) == 5
        assert find_space(tables, folder).labels == "mpcat40"


def test_a_dot_means_the_folder_that_one_is_in(site, monkeypatch):
    monkeypatch.chdir("flat")
    assert find_labels(".", Path("../tables")).name == "flat"
    assert find_space(Path("../tables"), ".").current().manifest.labels == "flat"
    assert find_space(Path("../tables"), "../flat").current().manifest.labels == "flat"


def test_a_link_to_a_folder_is_the_folder(site):
    (site / "mine").symlink_to(site / "flat")
    assert find_labels("mine", Path("tables")).name == "flat"
    assert find_space(Path("tables"), "mine").labels == "flat"


@pytest.mark.parametrize("where", [".", "tables"])
def test_a_published_name_needs_no_folder(site, monkeypatch, where):
    """Inside the tables folder the folder of that name holds tables, not labels."""
    expected = LabelSpace.load(site / "flat")
    shutil.move("flat", "elsewhere")
    monkeypatch.chdir(where)
    tables = Path("tables") if where == "." else Path()
    assert find_labels("flat", tables) == expected
    found = plan(tables=tables, scorer=FitScorer(), labels="flat", combinations="all")
    assert {stage.state for stage in found.stages} == {"cached"}
    report = build(tables=tables, scorer=FitScorer(), labels="flat", combinations="all")
    assert not report.published
    assert find_space(tables, "flat").labels == "flat"


def test_what_is_nowhere_is_refused(site):
    shutil.move("flat", "elsewhere")
    with pytest.raises(LabelSpaceError, match="no label space 'nowhere'"):
        find_labels("nowhere", Path("tables"))
    with pytest.raises(LabelSpaceError, match="no label space 'flat'"):
        find_labels("flat", Path("other"))
    with pytest.raises(LabelSpaceError, match=r"no label space '\./flat'"):
        find_labels("./flat", Path("tables"))
    with pytest.raises(LabelSpaceError):
        load_labels("flat")


def test_published_labels_that_are_damaged_are_refused(site):
    shutil.move("flat", "elsewhere")
    version = SpaceFolder(Path("tables"), "flat").current()
    (version.path / "labels" / "rooms.csv").write_text("room\ncellar\n")
    with pytest.raises(StoreError, match=r"rooms\.csv is not there as it was published"):
        find_labels("flat", Path("tables"))
