"""The README shows what the demo really prints."""

import re

import pytest

from end_to_end.demo_output import as_block, demo_output, in_readme

NUMBER = re.compile(r"\d+\.\d+")


def test_the_demo_in_the_readme_is_what_it_prints():
    shown, found = in_readme(), as_block(demo_output())
    # Another processor may round the last digits of a probability otherwise.
    assert _words(shown) == _words(found)
    numbers = [[float(number) for number in NUMBER.findall(text)] for text in (shown, found)]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-2, abs=1e-3)


def _words(text):
    text = re.sub(r"-[0-9a-f]{8} ", " ", text)  # what a version is made of
    return re.sub(r"[ -]+", " ", NUMBER.sub("#", text))
