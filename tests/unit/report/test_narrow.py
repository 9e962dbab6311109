"""The report on a phone, in a browser where there is one: nothing is cut off."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from roomtables import RoomTables, build
from roomtables.report.page import report
from roomtables.rooms import Room
from support import HashScorer

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium or chrome on this machine")

# What a frame of a phone's width says of the page in it. `cut` are elements whose content is wider
# than they are and that neither show it nor scroll; `scrolling` the sections with one that scrolls.
MEASURE = """
const frame = document.querySelector("iframe"), page = frame.contentDocument;
const wider = [...page.body.querySelectorAll("*")].filter(
  e => e.clientWidth && e.scrollWidth > e.clientWidth + 1);
const overflow = e => frame.contentWindow.getComputedStyle(e).overflowX;
document.title = JSON.stringify({
  inner: frame.contentWindow.innerWidth,
  page: page.documentElement.scrollWidth,
  cut: wider.filter(e => ["hidden", "clip"].includes(overflow(e))).map(e => e.outerHTML),
  scrolling: wider.filter(e => ["auto", "scroll"].includes(overflow(e)))
    .map(e => e.closest("section").id),
});
"""


def measured(page: str, width: int, folder: Path) -> dict[str, Any]:
    """How a page lies in a window of some width."""
    outer = folder / "outer.html"
    outer.write_text(
        '<!doctype html><meta charset="utf-8"><body>'
        f'<iframe width="{width}" height="800" style="border:0" srcdoc="{html.escape(page)}">'
        f'</iframe><script>addEventListener("load", () => {{{MEASURE}}});</script></body>',
        encoding="utf-8",
    )
    command = [str(BROWSER), "--headless=new", "--disable-gpu", "--dump-dom"]
    if os.geteuid() == 0:
        command.append("--no-sandbox")  # which root cannot have
    command += [f"--user-data-dir={folder / 'profile'}", "--window-size=1400,900", outer.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    (title,) = re.findall(r"<title>(\{.*?\})</title>", shown)
    return dict(json.loads(html.unescape(title)))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    tables = tmp_path_factory.mktemp("narrow")
    build(tables=tables, labels="mpcat40", scorer=HashScorer(), combinations="none")
    rooms = [
        Room("1", ("bed", "chest of drawers"), ("conference room",)),
        Room("2", ("gym equipment",), ("television room",)),
        Room("3", ("x" * 60,), ("utility room",)),
    ]
    return report(RoomTables.open(tables, "mpcat40", rule="pooled", offline=True), rooms)


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_cut_off(page: str, width: int, tmp_path: Path) -> None:
    found = measured(page, width, tmp_path)
    assert found["inner"] == width
    assert found["page"] <= width
    assert found["cut"] == []
    # Only what has a column per room may have to be scrolled.
    assert set(found["scrolling"]) <= {"map", "confusion"}


def test_a_page_that_is_too_wide_is_noticed(tmp_path: Path) -> None:
    wide = '<!doctype html><body><section id="s"><div style="width:600px">x</div></section>'
    assert measured(wide, 390, tmp_path)["page"] == 608
