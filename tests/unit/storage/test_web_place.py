"""Pulls from a plain web server: whatever it does, tables arrive whole, or nothing changes."""

import json
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from robot_tables import publish, publish_index
from roomtables import RoomTables
from roomtables.cli import main
from roomtables.errors import InputError, StoreError
from roomtables.labels import LabelSpace
from roomtables.storage.place import PATIENCE as PATIENT
from roomtables.storage.places import open_place
from roomtables.storage.pulling import FETCHED, pull
from roomtables.storage.pushing import push
from roomtables.storage.sent_misses import fetch_misses
from support import HashScorer
from web_server import Handler, serving

SPACE = LabelSpace.named("home", ["bed", "sink", "stove", "toilet"], ["bathroom", "kitchen"])


@pytest.fixture
def server(tmp_path):
    (tmp_path / "place").mkdir(exist_ok=True)
    with serving(tmp_path / "place") as served:
        yield served


@pytest.fixture
def built(tmp_path):
    tables = tmp_path / "built"
    publish(tables, SPACE, HashScorer())
    push(tables, "home", f"file://{tmp_path}/place")
    return tables


def rebuild(tables, scorer="other@1"):
    publish(tables, SPACE, HashScorer(scorer))
    push(tables, "home", f"file://{tables.parent}/place")


def scores(tables):
    return RoomTables.open(tables, "home", offline=True).classify(["bed", "sink"]).probabilities


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def largest(place):
    return max((place / "home/files").iterdir(), key=lambda path: path.stat().st_size)


@pytest.mark.parametrize("ranges", [True, False])
def test_tables_arrive_whole(built, server, tmp_path, ranges):
    server.ranges = ranges
    done = pull(tmp_path / "robot", "home", server.url)
    assert done.new
    assert scores(tmp_path / "robot") == scores(built)
    before = len(server.asked)
    assert not pull(tmp_path / "robot", "home", server.url).new
    assert [path for path, _ in server.asked[before:]] == ["/home/CURRENT", "/home/CHECKED"]


FAULTS = [
    Handler.cut, Handler.stall, Handler.stall_at_once, Handler.drip, Handler.drip_in_the_head,
    Handler.fail, Handler.miss, Handler.forbid, Handler.shorten, Handler.swap,
    Handler.tell_no_length, Handler.speak_no_http, Handler.redirect_elsewhere,
]  # fmt: skip


@pytest.mark.parametrize("where", ["CURRENT", "versions", "files"])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_bad_server_is_one_line_and_changes_nothing(built, server, tmp_path, fault, where):
    robot = tmp_path / "robot"
    pull(robot, "home", server.url)
    old = scores(robot)
    rebuild(built)
    server.faults[where] = fault
    began = time.monotonic()
    said = run("pull", server.url, "--tables", robot, "--labels", "home", "--timeout", "0.4")
    assert said.exit_code == 1, said.output
    assert said.stderr.startswith("error: ")
    assert said.stderr.count("\n") == 1, said.stderr
    assert time.monotonic() - began < 20
    assert scores(robot) == old
    server.faults.clear()
    assert pull(robot, "home", server.url).new
    assert scores(robot) == scores(built) != old


def test_no_date_of_a_place_keeps_its_tables_away(built, server, tmp_path):
    (tmp_path / "place/home/CHECKED").write_bytes(b"x" * 10_000)
    assert pull(tmp_path / "robot", "home", server.url).new


@pytest.mark.parametrize("ranges", [True, False])
def test_a_cut_pull_goes_on_where_it_was(built, server, tmp_path, ranges):
    server.ranges = ranges
    file = largest(tmp_path / "place")
    size = file.stat().st_size
    server.faults[file.name] = Handler.stall
    with pytest.raises(StoreError):
        pull(tmp_path / "robot", "home", server.url, patience=PATIENT._replace(seconds=0.3))
    part = tmp_path / "robot/home" / FETCHED / file.name
    held = part.stat().st_size
    assert 0 < held < size
    server.faults.clear()
    server.asked.clear()
    assert pull(tmp_path / "robot", "home", server.url).new
    assert (f"/home/files/{file.name}", f"bytes={held}-") in server.asked
    assert scores(tmp_path / "robot") == scores(built)


def test_a_cut_file_is_asked_for_again_from_there(built, server, tmp_path):
    file = largest(tmp_path / "place")
    server.faults[file.name] = once(server, Handler.cut)
    done = pull(tmp_path / "robot", "home", server.url)
    assert done.bytes_fetched == sum(
        path.stat().st_size for path in (tmp_path / "place/home/files").iterdir()
    )
    cut_at = file.stat().st_size // 3
    assert (f"/home/files/{file.name}", f"bytes={cut_at}-") in server.asked


def once(server, fault):
    """A fault that passes."""

    def first(handler, content):
        server.faults.clear()
        fault(handler, content)

    return first


def test_another_part_than_was_asked_for_is_refused(built, server, tmp_path):
    file = largest(tmp_path / "place")
    part = tmp_path / "robot/home" / FETCHED / file.name
    part.parent.mkdir(parents=True)
    part.write_bytes(file.read_bytes()[:9])
    server.faults[file.name] = Handler.send_other_part
    with pytest.raises(StoreError, match="another part"):
        pull(tmp_path / "robot", "home", server.url)


def test_a_server_that_fails_for_a_moment_is_asked_again(built, server, tmp_path):
    server.faults["CURRENT"] = once(server, Handler.fail)
    assert pull(tmp_path / "robot", "home", server.url).new


def test_a_slow_line_is_no_fault(built, server, tmp_path):
    """Slower than a stall would be for the whole, as fast as the least that is asked for."""

    def slowly(handler, content):
        handler.send_response(200)
        handler.head(len(content))
        for at in range(0, len(content), 500):
            handler.body(content[at : at + 500])
            time.sleep(0.05)

    server.faults["files"] = slowly
    patience = PATIENT._replace(seconds=0.3)
    assert pull(tmp_path / "robot", "home", server.url, patience=patience).new


def test_a_web_server_is_not_written_to(built, server, tmp_path):
    for call in (push, fetch_misses):
        with pytest.raises(StoreError, match="is a web server"):
            call(built, "home", server.url)


@pytest.mark.parametrize("url", ["http://", "https:///tables", "http://host:port/tables"])
def test_a_url_without_a_server_is_refused(url):
    with pytest.raises(InputError, match="names no server"):
        open_place(url)


def test_no_server_is_one_line(tmp_path):
    said = run("pull", "http://127.0.0.1:9/tables", "--tables", tmp_path, "--labels", "home")
    assert said.exit_code == 1
    assert "Connection refused" in said.stderr


def test_what_a_url_holds_of_a_login_is_sent_and_not_said(built, server, tmp_path):
    logins = []
    server.faults["CURRENT"] = lambda handler, content: (
        logins.append(handler.headers["Authorization"]),
        handler.serve(content),
    )
    url = server.url.replace("//", "//robot:s%20cret@")
    pull(tmp_path / "robot", "home", url)
    assert logins == ["Basic cm9ib3Q6cyBjcmV0"]
    said = run("status", "--tables", tmp_path / "robot", "--labels", "home")
    assert server.url in said.output
    assert "cret" not in said.output


def test_tables_for_which_there_is_no_room_are_refused_before_they_come(built, server, tmp_path):
    (index,) = (tmp_path / "place/home/versions").iterdir()
    publish_with_size(index, 10**17)
    with pytest.raises(StoreError, match=r"to fetch, and .* MB are free at"):
        pull(tmp_path / "robot", "home", server.url)
    assert not any(path.startswith("/home/files") for path, _ in server.asked)


def publish_with_size(index: Path, size: int) -> None:
    """An index that says of one file that it is so large."""
    value = json.loads(index.read_text())
    next(iter(value["files"].values()))["bytes"] = size
    publish_index(index, value)
