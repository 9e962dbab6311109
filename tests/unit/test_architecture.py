"""docs/architecture.md tells of the floors what the import contracts hold."""

import re
from configparser import ConfigParser
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def floors_of_the_page():
    """The rooms of each floor, the roof first."""
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", PAGE, flags=re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(len(rows)))[::-1]
    return [set(re.findall(r"`(\w+)`", rooms)) for _, rooms in rows]


def contracts():
    parser = ConfigParser()
    parser.read(ROOT / ".importlinter")
    return parser


def test_the_floors_are_those_of_the_contract():
    layers = contracts()["importlinter:contract:floors"]["layers"].split("\n")
    held = [set(re.findall(r"\w+", layer)) for layer in layers if layer.strip()]
    assert floors_of_the_page() == held


def test_every_room_has_its_floor():
    package = ROOT / "src" / "roomtables"
    found = {path.parent.name for path in package.glob("*/__init__.py")}
    found |= {path.stem for path in package.glob("[!_]*.py")}
    assert set().union(*floors_of_the_page()) == found


def test_the_other_rules_are_the_other_contracts():
    rules = {
        name: set(section["protected_modules"].split())
        for name, section in contracts().items()
        if section.get("type") == "protected"
    }
    assert list(rules.values())[:2] == [{"torch", "transformers"}, {"duckdb", "pyarrow"}]
    (sentence,) = re.findall(r"^`lint-imports` holds.*?\n\n", PAGE, flags=re.MULTILINE | re.DOTALL)
    for packages in rules.values():
        assert all(package in sentence for package in packages)


def test_each_question_names_one_file():
    answers = re.findall(r"^\| [^`|]*?(?:\\\|[^|]*)*\? \| \[.*?\]\((.*?)\) \|", PAGE, re.MULTILINE)
    assert len(answers) == 5
    assert all((ROOT / "docs" / answer).is_file() for answer in answers)
