"""docs/sql.md shows what its queries really print."""

import re

import pytest

from end_to_end.sql_page import PAGE, answers, queries

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def test_the_output_on_the_page_is_what_the_queries_print():
    pytest.importorskip("torch")
    asked = queries(PAGE.read_text(encoding="utf-8"))
    assert len(asked) == 19
    found = answers([query for query, _ in asked])
    for (query, shown), printed in zip(asked, found, strict=True):
        assert _words(shown) == _words(printed), query
        # Another processor may round the last digit otherwise.
        numbers = [[float(n) for n in NUMBER.findall(text)] for text in (shown, printed)]
        assert numbers[0] == pytest.approx(numbers[1], abs=0.11), query


def _words(text):
    return re.sub(r"[ -]+", " ", NUMBER.sub("#", text))
