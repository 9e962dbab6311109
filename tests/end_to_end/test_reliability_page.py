"""Every promise of docs/reliability.md names a test, and the test is there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "reliability.md").read_text()
PROMISES = [
    line for line in TEXT.splitlines()
    if line.startswith("| ") and not line.startswith("| promise")
]  # fmt: skip


@pytest.mark.parametrize("line", PROMISES, ids=lambda line: line[2:42])
def test_a_promise_is_held_by_a_test(line):
    named = re.findall(r"`(tests/\S+\.py)::(\w+)`", line.rsplit(" | ", 1)[1])
    assert named
    for path, name in named:
        tree = ast.parse((ROOT / path).read_text())
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_there_are_promises():
    assert len(PROMISES) > 20
