"""Which published tables are meant where nothing is said."""

import pytest

from roomtables.errors import StoreError
from roomtables.storage.spaces import find_space, published_labels
from roomtables.storage.versions import CURRENT


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
