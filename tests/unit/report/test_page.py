"""The report page: well-formed, self-contained, and holding what the tables hold."""

import json
from html.parser import HTMLParser

import pytest
from click.testing import CliRunner

from roomtables import RoomTables
from roomtables.cli import main
from roomtables.labels import LabelSpace
from roomtables.report.html import Bar, heat_map, table
from roomtables.report.page import report
from roomtables.rooms import Room
from support import HashScorer, write_space
from tiny_tables import OBJECTS, build_tables

ROOMS = [
    Room("1", ("bed", "lamp"), ("bedroom",)),
    Room("2", ("oven", "<b>&"), ("kitchen",)),
    Room("3", ("piano",), ("office",)),
]


class Strict(HTMLParser):
    """Fails on a tag that is not closed in order; collects what a page would load."""

    VOID = frozenset({"meta", "path", "use"})

    def __init__(self):
        super().__init__()
        self.open, self.loads, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        self.loads += [v for k, v in attrs if k in {"src", "href", "xlink:href"} and v[0] != "#"]

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def parsed(page):
    parser = Strict()
    parser.feed(page)
    assert parser.open == []
    return parser


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build_tables(tmp_path_factory.mktemp("report"))


def test_a_page_with_rooms(folder):
    tables = RoomTables.open(folder, "flat", rule="pooled", offline=True)
    page = parsed(report(tables, ROOMS))
    text = " ".join(page.text)
    assert page.loads == []  # nothing from any other file, let alone the network
    for heading in ("p(room | object)", "What each room is recognised by", "Confusion", "Coverage"):
        assert heading in text
    assert all(name in text for name in OBJECTS)
    assert "fit-scorer" in text
    assert "2 of 3 rooms right" in text
    assert "unanswered" in text
    assert "<b>&" in text  # an odd name is text, not markup


def test_a_page_without_rooms_needs_no_matplotlib(folder, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    page = parsed(report(RoomTables.open(folder, "flat", offline=True)))
    assert "Accuracy" not in " ".join(page.text)


def test_a_long_label_space_stays_whole(tmp_path):
    from roomtables import build

    space = LabelSpace.named("long", [f"thing {n}" for n in range(200)], ["hall", "kitchen"])
    labels = str(write_space(tmp_path, space))
    build(tables=tmp_path / "t", labels=labels, scorer=HashScorer(), combinations="none")
    page = report(RoomTables.open(tmp_path / "t", "long", offline=True))
    parsed(page)
    assert page.count("<tr><th>thing ") == 200
    assert "position: sticky" in page


def test_cells():
    assert 'style="width:50.0%"' in table(("a",), [(Bar(0.5),)])
    assert '<td class="n">1,234</td>' in table(("a",), [(1234,)])
    shaded = heat_map("x", ["a", "b"], [("r", [3.0, 1.0])], count=True)
    assert ">3</td>" in shaded
    assert "r, b: 1 rooms" in shaded


def test_report_command(folder, tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text("".join(json.dumps(room.as_json()) + "\n" for room in ROOMS))
    common = ["report", "--tables", str(folder), "--labels", "flat", "--offline"]
    out = tmp_path / "page.html"
    found = CliRunner().invoke(main, [*common, str(rooms), "-o", str(out)])
    assert found.exit_code == 0, found.output
    parsed(out.read_text())
    assert CliRunner().invoke(main, common).exit_code == 2
    lost = CliRunner().invoke(main, [*common, "-o", str(tmp_path / "none" / "page.html")])
    assert (lost.exit_code, lost.stdout) == (1, "")
