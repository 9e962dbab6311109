"""Misses travel home once, bounded and verified; whatever is no misses is skipped and named."""

import hashlib
import json

import pytest

from robot_tables import publish
from roomtables import RoomTables
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.storage import place
from roomtables.storage.miss_log import FILE_BYTES, FOLDER, MissLog
from roomtables.storage.misses import SENT_NOTE, Misses
from roomtables.storage.pulling import pull
from roomtables.storage.pushing import push
from roomtables.storage.sent_misses import fetch_misses, send_misses
from support import HashScorer

SPACE = LabelSpace.named("home", ["bed", "sink", "stove", "toilet"], ["bathroom", "kitchen"])
ASKED = ["bed", "sink", "stove"]


@pytest.fixture
def url(tmp_path):
    return f"file://{tmp_path}/place"


@pytest.fixture
def robot(tmp_path, url):
    """A robot with pulled tables, which was asked for a combination twice in vain."""
    publish(tmp_path / "built", SPACE, HashScorer())
    push(tmp_path / "built", "home", url)
    pull(tmp_path / "robot", "home", url)
    log = MissLog(tmp_path / "robot/home" / FOLDER)
    log.note("proxy", [ASKED])
    log.note("proxy", [ASKED, ["bed"]])
    return tmp_path / "robot"


def at_home(tmp_path):
    found = Misses.read(tmp_path / "built/home" / FOLDER).open
    return {miss.objects: miss.times_asked for miss in found}


def test_misses_come_home_once(robot, url, tmp_path):
    sent = send_misses(robot, "home", url)
    assert (sent.combinations, sent.files) == (2, 1)
    assert send_misses(robot, "home", url)[1:] == (0, 0, 0)
    assert fetch_misses(tmp_path / "built", "home", url).files == 1
    assert at_home(tmp_path) == {("bed", "sink", "stove"): 2, ("bed",): 1}
    assert fetch_misses(tmp_path / "built", "home", url).files == 0
    Misses.read(tmp_path / "built/home" / FOLDER).take_in()
    fetch_misses(tmp_path / "built", "home", url)
    assert at_home(tmp_path) == {}


def test_only_new_misses_are_sent_again(robot, url, tmp_path):
    send_misses(robot, "home", url)
    MissLog(robot / "home" / FOLDER).note("proxy", [["toilet"]])
    assert send_misses(robot, "home", url).combinations == 1
    fetch_misses(tmp_path / "built", "home", url)
    assert at_home(tmp_path) == {("bed", "sink", "stove"): 2, ("bed",): 1, ("toilet",): 1}


def test_what_was_sent_stays_open_for_a_build_on_the_robot(robot, url):
    send_misses(robot, "home", url)
    assert len(Misses.read(robot / "home" / FOLDER).open) == 2


def test_files_that_are_gone_are_forgotten(robot, url):
    send_misses(robot, "home", url)
    note = robot / "home" / FOLDER / SENT_NOTE
    assert len(json.loads(note.read_text())["read"]) == 1
    for path in (robot / "home" / FOLDER).glob("*.jsonl"):
        path.unlink()
    Misses.read(robot / "home" / FOLDER, SENT_NOTE).take_in(remove=False)
    assert not json.loads(note.read_text())["read"]


def test_misses_that_came_from_a_place_are_not_sent_on(robot, url, tmp_path):
    send_misses(robot, "home", url)
    fetch_misses(tmp_path / "built", "home", url)
    assert send_misses(tmp_path / "built", "home", url).combinations == 0


def test_many_misses_go_in_files_of_a_bounded_size(robot, url, tmp_path, monkeypatch):
    monkeypatch.setattr("roomtables.storage.sent_misses.FILE_BYTES", 150)
    assert send_misses(robot, "home", url).files == 2
    monkeypatch.undo()
    fetch_misses(tmp_path / "built", "home", url)
    assert at_home(tmp_path) == {("bed", "sink", "stove"): 2, ("bed",): 1}


def put(tmp_path, content, name=None):
    folder = tmp_path / "place/home" / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256(content).hexdigest()
    (folder / (name or f"robot-{digest}.jsonl")).write_bytes(content)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"{}", "notes.txt"),
        (b"{}", "robot-" + "0" * 64 + ".jsonl"),
        (b" " * (FILE_BYTES + 1), None),
    ],
)
def test_a_file_that_is_not_as_its_name_says_is_skipped(
    robot, url, tmp_path, caplog, content, name
):
    put(tmp_path, content, name)
    send_misses(robot, "home", url)
    done = fetch_misses(tmp_path / "built", "home", url)
    assert (done.files, done.skipped) == (1, 1)
    assert "is skipped" in caplog.text
    assert at_home(tmp_path) == {("bed", "sink", "stove"): 2, ("bed",): 1}


LINE = {"source": "proxy", "objects": ["bed"], "asked": "2026-01-01T00:00:00+00:00"}


@pytest.mark.parametrize("times", [0, -1, 10**30, 1.5, True, "9", None])
def test_a_line_that_counts_wrongly_is_skipped(robot, url, tmp_path, caplog, times):
    bad = json.dumps(LINE | {"times": times}).encode()
    put(tmp_path, bad + b"\n" + json.dumps(LINE | {"times": 4}).encode() + b"\n")
    fetch_misses(tmp_path / "built", "home", url)
    assert at_home(tmp_path) == {("bed",): 4}
    assert "lines that are no misses: 1" in caplog.text


def test_no_more_than_a_folder_holds_is_fetched(robot, url, tmp_path, monkeypatch, caplog):
    for number in range(4):
        put(tmp_path, json.dumps(LINE).encode() + b" " * (100 + number) + b"\n")
    monkeypatch.setattr("roomtables.storage.sent_misses.FOLDER_BYTES", 400)
    assert fetch_misses(tmp_path / "built", "home", url).files == 2
    assert "waits for the next build" in caplog.text
    monkeypatch.undo()
    assert fetch_misses(tmp_path / "built", "home", url).files == 2


def test_a_damaged_note_of_what_came_is_as_none(robot, url, tmp_path):
    send_misses(robot, "home", url)
    fetch_misses(tmp_path / "built", "home", url)
    (tmp_path / "built/home" / FOLDER / "fetched.json").write_text("[1")
    assert fetch_misses(tmp_path / "built", "home", url).files == 1
    assert at_home(tmp_path) == {("bed", "sink", "stove"): 2, ("bed",): 1}


def test_a_robot_asks_its_tables_and_never_the_place(robot, url, tmp_path):
    (tmp_path / "place").rename(tmp_path / "gone")
    assert RoomTables.open(robot, "home", offline=True).classify(["bed"]).room


def test_a_file_that_cannot_be_read_costs_only_itself(robot, url, tmp_path, caplog, monkeypatch):
    put(tmp_path, json.dumps(LINE).encode() + b"\n")
    [bad] = (tmp_path / "place/home" / FOLDER).iterdir()
    send_misses(robot, "home", url)
    whole = place.read_small

    def refused(there, name, most):
        if bad.name in name:
            raise StoreError("access denied")
        return whole(there, name, most)

    monkeypatch.setattr("roomtables.storage.sent_misses.read_small", refused)
    done = fetch_misses(tmp_path / "built", "home", url)
    assert (done.files, done.skipped) == (1, 1)
    assert f"{bad.name} is skipped: access denied" in caplog.text
    monkeypatch.undo()
    assert fetch_misses(tmp_path / "built", "home", url).files == 1


def test_what_is_no_misses_is_fetched_and_named_once(robot, url, tmp_path, caplog):
    put(tmp_path, b"{}", "robot-" + "0" * 64 + ".jsonl")
    assert fetch_misses(tmp_path / "built", "home", url).skipped == 1
    caplog.clear()
    assert fetch_misses(tmp_path / "built", "home", url).skipped == 0
    assert not caplog.text


def test_a_place_that_is_not_there_once_makes_no_file_new(robot, url, tmp_path):
    send_misses(robot, "home", url)
    fetch_misses(tmp_path / "built", "home", url)
    fetch_misses(tmp_path / "built", "home", f"file://{tmp_path}/nowhere")
    assert fetch_misses(tmp_path / "built", "home", url).files == 0


def test_a_file_that_a_build_has_taken_in_makes_room_at_once(robot, url, tmp_path):
    send_misses(robot, "home", url)
    fetch_misses(tmp_path / "built", "home", url)
    folder = tmp_path / "built/home" / FOLDER
    assert list(folder.glob("+*.jsonl"))
    Misses.read(folder).take_in()
    assert not list(folder.glob("+*.jsonl"))
