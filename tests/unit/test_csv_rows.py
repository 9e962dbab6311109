import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.csv_rows import read_csv
from roomtables.errors import InputError


def rows(tmp_path, text, required=("a",)):
    path = tmp_path / "x.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return list(read_csv(path, required))


def test_rows_come_with_their_place(tmp_path):
    (where, row), (second, _) = rows(tmp_path, "\ufeffa, b\n1,2\n3,4\n")
    assert row == {"a": "1", "b": "2"}
    assert where.endswith("x.csv, line 2")
    assert second.endswith("line 3")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("b\n1\n", "missing column `a`"),
        ("", "missing column `a`"),
        ("a,b\n1\n", "line 2: expected 2 fields"),
        ("a,b\n1,2,3\n", "line 2: expected 2 fields"),
        (b"a\n\xff\n", "not UTF-8"),
    ],
)
def test_malformed_files_are_named(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        rows(tmp_path, text)


@given(data=st.binary(max_size=200))
def test_any_bytes_are_rows_or_an_input_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("csv") / "x.csv"
    path.write_bytes(b"a,b\n" + data)
    with contextlib.suppress(InputError):
        list(read_csv(path, ("a",)))
