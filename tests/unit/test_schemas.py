from pathlib import Path

import duckdb
import pytest

from roomtables import build
from roomtables.schemas import TABLE_BY_NAME, TABLES, VERSION_TABLES, data_dictionary
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space


def test_the_committed_data_dictionary_is_generated():
    path = Path(__file__).parents[2] / "tables" / "README.md"
    assert path.read_text(encoding="utf-8") == data_dictionary()


def test_names_are_unique_and_keys_exist():
    assert len(TABLE_BY_NAME) == len(TABLES)
    for table in TABLES:
        names = [column.name for column in table.columns]
        assert len(set(names)) == len(names)
        assert set(table.key) <= set(names)


@pytest.fixture(scope="module")
def version(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    labels = str(write_space(folder / "labels", small_space()))
    build(tables=folder, labels=labels, scorer=HashScorer())
    return SpaceFolder(folder, "small").current()


@pytest.mark.parametrize("name", VERSION_TABLES)
def test_published_files_have_the_schema(version, name):
    described = duckdb.sql(f"describe select * from '{version.path / name}.parquet'").fetchall()
    rooms = [room.label for room in small_space().predicted_rooms]
    expected = [(c.name, c.type.upper()) for c in TABLE_BY_NAME[name].columns_for(rooms)]
    assert [row[:2] for row in described] == expected


@pytest.mark.parametrize("name", VERSION_TABLES)
def test_keys_are_unique(version, name):
    key = ", ".join(TABLE_BY_NAME[name].key)
    path = f"'{version.path / name}.parquet'"
    counts = duckdb.sql(f"select count(*), count(distinct ({key})) from {path}").fetchall()
    assert counts[0][0] == counts[0][1] > 0
