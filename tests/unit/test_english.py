import subprocess
import sys

import pytest

from roomtables import english


@pytest.mark.parametrize(
    ("label", "plural"),
    [
        ("toilet", "toilets"),
        ("chest of drawers", "chests of drawers"),
        ("shelf", "shelves"),
        ("bookshelf", "bookshelves"),
        ("shelves", "shelves"),
        ("clothes", "clothes"),
        ("gym equipment", "gym equipment"),
        ("stairs", "stairs"),
        ("blinds", "blinds"),
        ("box", "boxes"),
        ("knife", "knives"),
        ("person", "people"),
        ("mouse", "mice"),
        ("toilet paper", "toilet paper"),
        ("paper towel", "paper towels"),
        ("soap bottle", "soap bottles"),
        ("compass", "compasses"),
        ("bus", "buses"),
        ("lens", "lenses"),
    ],
)
def test_plurals(label, plural):
    assert english.pluralise(label) == plural


@pytest.mark.parametrize("label", ["toilet", "glass", "bus", "tennis", "clothes", "furniture"])
def test_what_is_no_plural_has_no_singular(label):
    assert english.singular(label) is None


@pytest.mark.parametrize(("label", "one"), [("shelves", "shelf"), ("stairs", "stair")])
def test_singular_of_plurals(label, one):
    assert english.singular(label) == one


@pytest.mark.parametrize(
    ("label", "article"),
    [("office", "an"), ("utility room", "a"), ("hallway", "a"), ("x-ray room", "an"), ("spa", "a")],
)
def test_articles(label, article):
    assert english.article(label) == article


@pytest.mark.parametrize(
    "label", ["", "'; drop table objects", "🛁", "1984", "a" * 5000, "a, and b"]
)
def test_what_is_no_name_is_left_alone(label):
    assert english.pluralise(label) == label
    assert english.singular(label) is None
    assert english.article(label) == "a"


def test_what_is_known_or_no_name_needs_no_inflect():
    code = (
        "import importlib.util, sys\n"
        "importlib.util.find_spec = lambda name: None\n"
        "from roomtables.english import can_inflect\n"
        "print([can_inflect(name) for name in ('ac unit', '1984', 'unicorn horn')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[True, True, False]\n"
    assert "roomtables[robot]" in done.stderr


def test_a_name_that_nobody_noted_costs_less_than_a_second():
    code = (
        "import sys, time\n"
        "from roomtables import english\n"
        "began = time.process_time()\n"
        "print(english.pluralise('unicorn horn'), english.pluralise('grandfather clock'))\n"
        "import typeguard\n"
        "assert typeguard.typechecked.__module__.startswith('typeguard')\n"
        "sys.exit(time.process_time() - began > 1)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("unicorn horns grandfather clocks")
