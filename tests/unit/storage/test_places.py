"""Tables travel through a place: what arrives is what was sent, or nothing changes."""

import hashlib
import json
import os
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner

from robot_tables import publish, publish_index
from roomtables import RoomTables
from roomtables.cli import main
from roomtables.errors import InputError, StoreError
from roomtables.labels import LabelSpace
from roomtables.storage.checked import CHECKED, last_checked, note_checked
from roomtables.storage.origin import ORIGIN, origin_of
from roomtables.storage.place import shown
from roomtables.storage.pulling import FETCHED, pull
from roomtables.storage.pushing import push
from roomtables.storage.versions import SpaceFolder
from support import HashScorer

SPACE = LabelSpace.named("home", ["bed", "sink", "stove", "toilet"], ["bathroom", "kitchen"])


@pytest.fixture
def built(tmp_path):
    tables = tmp_path / "built"
    publish(tables, SPACE, HashScorer())
    return tables


@pytest.fixture(params=["file", "memory", "local"])
def url(request, tmp_path):
    if request.param == "file":
        return f"file://{tmp_path}/place"
    pytest.importorskip("fsspec")
    if request.param == "local":  # fsspec's own, with folders that are to be made
        return f"local://{tmp_path}/place"
    return f"memory://{tmp_path.name}"


def scores(tables):
    return RoomTables.open(tables, "home", offline=True).classify(["bed", "sink"]).probabilities


def test_what_arrives_answers_as_what_was_sent(built, url, tmp_path):
    assert push(built, "home", url).moved
    done = pull(tmp_path / "robot", "home", url)
    assert done.new
    assert done.bytes_fetched > 0
    assert scores(tmp_path / "robot") == scores(built)
    again = push(built, "home", url)
    assert (again.files, again.moved) == (0, False)
    assert not pull(tmp_path / "robot", "home", url).new


def test_only_what_changed_is_fetched(built, url, tmp_path):
    push(built, "home", url)
    first = pull(tmp_path / "robot", "home", url)
    publish(built, SPACE, HashScorer(), prior_weight=0.25)
    push(built, "home", url)
    second = pull(tmp_path / "robot", "home", url)
    assert second.new
    assert second.bytes_here > 0
    assert second.bytes_fetched < first.bytes_fetched


def test_a_damaged_version_is_mended_by_the_next_pull(built, url, tmp_path):
    push(built, "home", url)
    pull(tmp_path / "robot", "home", url)
    (array, *_) = (tmp_path / "robot" / "home").glob("0*/lookup/*scores*.npy")
    array.write_bytes(b"x")
    assert pull(tmp_path / "robot", "home", url).new
    assert scores(tmp_path / "robot") == scores(built)


def contents(tmp_path):
    return max((tmp_path / "place/home/files").iterdir(), key=lambda path: path.stat().st_size)


@pytest.mark.parametrize("change", [lambda b: b[:-1], lambda b: b[::-1], lambda b: b""])
def test_a_wrong_file_at_the_place_changes_nothing(built, tmp_path, change):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    robot = tmp_path / "robot"
    pull(robot, "home", url)
    publish(built, SPACE, HashScorer("other@1"))
    push(built, "home", url)
    before = scores(robot)
    for path in (tmp_path / "place/home/files").iterdir():
        path.write_bytes(change(path.read_bytes()))
    with pytest.raises(StoreError):
        pull(robot, "home", url)
    assert scores(robot) == before
    push(built, "home", url)


def test_a_cut_transfer_goes_on_where_it_was(built, tmp_path):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    largest = contents(tmp_path)
    whole = largest.read_bytes()
    largest.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StoreError):
        pull(tmp_path / "robot", "home", url)
    part = tmp_path / "robot/home" / FETCHED / largest.name
    assert part.stat().st_size == len(whole) // 2
    largest.write_bytes(whole)
    done = pull(tmp_path / "robot", "home", url)
    sent = sum(path.stat().st_size for path in (tmp_path / "place/home/files").iterdir())
    assert 0 < done.bytes_fetched <= sent - len(whole) // 2
    assert not part.parent.exists()


@pytest.mark.parametrize("name", ["../../evil", "/etc/evil", "lookup/../../evil", "CURRENT"])
def test_a_hostile_index_writes_nothing_outside(built, tmp_path, name):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    (index,) = (tmp_path / "place/home/versions").iterdir()
    value = json.loads(index.read_text())
    value["files"][name] = next(iter(value["files"].values()))
    publish_index(index, value)
    with pytest.raises(StoreError, match=r"is no file of tables|`files` names"):
        pull(tmp_path / "robot", "home", url)
    assert not list(tmp_path.rglob("evil"))
    assert not (tmp_path / "robot/home/CURRENT").exists()


def test_old_versions_go_and_the_published_one_stays(built, tmp_path):
    url = f"file://{tmp_path}/place"
    for weight in (0.1, 0.2, 0.3, 0.4):
        publish(built, SPACE, HashScorer(), prior_weight=weight)
        push(built, "home", url, keep=2)
    versions = tmp_path / "place/home/versions"
    assert len(list(versions.iterdir())) == 4  # all written lately
    space = SpaceFolder(built, "home")
    space.point_at(space.versions()[0])
    push(built, "home", url, keep=2)
    past = time.time() - 7200
    for path in (tmp_path / "place").rglob("*"):
        os.utime(path, (past, past))
    removed = push(built, "home", url, keep=1).removed
    assert removed > 0
    assert pull(tmp_path / "robot", "home", url).new
    arrived = SpaceFolder(tmp_path / "robot", "home").current().manifest
    needed = {facts.sha256 for facts in arrived.files.values()}
    assert needed <= {path.name for path in (tmp_path / "place/home/files").iterdir()}


def test_a_place_is_no_folder():
    with pytest.raises(StoreError, match=r"run `roomtables pull s3://b/t --tables tables`"):
        RoomTables.open("s3://b/t")
    with pytest.raises(InputError, match="is no URL"):
        pull(Path("tables"), "home", "somewhere")


def test_progress_counts_every_byte_once(built, tmp_path):
    url = f"file://{tmp_path}/place"
    for run in (push, pull, push, pull):
        calls = []
        run(
            built if run is push else tmp_path / "robot",
            "home",
            url,
            progress=lambda *c, to=calls: to.append(c),
        )
        assert all(total == sum(done for done, _ in calls) for _, total in calls)
        files = [path.stat().st_size for path in (tmp_path / "place/home/files").iterdir()]
        assert sum(done for done, _ in calls) == sum(files) or (run is pull and not calls)


def status(tables, *options):
    words = ["status", "--tables", str(tables), "--labels", "home", *options]
    return CliRunner().invoke(main, words)


def test_when_tables_were_last_found_up_to_date_travels_with_them(built, url, tmp_path):
    robot = tmp_path / "robot"
    push(built, "home", url)
    pull(robot, "home", url)
    here, there = (SpaceFolder(tables, "home").current() for tables in (built, robot))
    assert last_checked(there) is None
    for day in (25, 26):
        moment = datetime(2026, 11, day, 2, 31, 7, tzinfo=timezone.utc)
        note_checked(here, moment)
        push(built, "home", url)
        assert not pull(robot, "home", url).new
        assert last_checked(there) == moment
    publish(built, SPACE, HashScorer("other@1"))
    push(built, "home", url)
    pull(robot, "home", url)
    assert last_checked(SpaceFolder(robot, "home").current()) is None


def test_a_robots_status_says_how_old_tables_are_and_when_the_place_was_asked(built, tmp_path):
    robot, url = tmp_path / "robot", f"file://{tmp_path}/place"
    push(built, "home", url)
    pull(robot, "home", url)
    old = origin_of(SpaceFolder(robot, "home").current())
    line = (robot / "home" / ORIGIN).read_text()
    long_ago = old.pulled - timedelta(days=2)
    (robot / "home" / ORIGIN).write_text(line.replace(old.pulled.isoformat(), long_ago.isoformat()))
    said = status(robot, "--max-age", "0s")
    assert said.exit_code == 1
    assert f"({url} was last asked {long_ago.isoformat()})" in said.stderr
    assert f"`roomtables pull {url} --tables {robot} --labels home`" in said.stderr
    note_checked(SpaceFolder(built, "home").current(), datetime.now(timezone.utc))
    push(built, "home", url)
    pull(robot, "home", url)
    found = json.loads(status(robot, "--max-age", "1h", "--format", "json").stdout)
    assert found["pulled_from"] == url
    assert found["pulled"] == long_ago.isoformat()
    assert datetime.fromisoformat(found["last_pull"]) >= old.asked
    assert status(built, "--max-age", "1h").exit_code == 0
    assert json.loads(status(built, "--format", "json").stdout)["last_pull"] is None


@pytest.mark.parametrize("said", [b"", b"x" * 9000, b"9999-99-99 {name}", b"\xff\xfe"])
def test_a_damaged_date_at_a_place_is_as_none(built, tmp_path, said):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    name = SpaceFolder(built, "home").current().name.encode()
    (tmp_path / "place/home" / CHECKED).write_bytes(said.replace(b"{name}", name))
    assert pull(tmp_path / "robot", "home", url).new
    assert last_checked(SpaceFolder(tmp_path / "robot", "home").current()) is None


def test_what_a_killed_push_left_half_written_goes_later(built, tmp_path):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    left = tmp_path / "place/home/versions/.000009-madeupxx-01234567.json.0a1b2c3d.tmp"
    left.write_bytes(b"{")
    push(built, "home", url)
    assert left.exists()  # it may be written at this moment
    past = time.time() - 7200
    os.utime(left, (past, past))
    push(built, "home", url)
    assert not left.exists()


def test_an_archive_of_what_a_place_publishes_is_known_to_come_from_there(built, tmp_path):
    """As a pull that was killed behind its switch: the next one notes what that one did not."""
    robot, url = tmp_path / "robot", f"file://{tmp_path}/place"
    push(built, "home", url)
    pull(robot, "home", url)
    (robot / "home" / ORIGIN).unlink()
    assert not pull(robot, "home", url).new
    assert origin_of(SpaceFolder(robot, "home").current()).url == url


def test_what_was_fetched_of_another_version_takes_no_room(built, tmp_path):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    left = tmp_path / "robot/home" / FETCHED / ("0" * 64)
    left.parent.mkdir(parents=True)
    left.write_bytes(b"x" * 1000)
    (tmp_path / "place/home/CURRENT").rename(tmp_path / "kept")
    with pytest.raises(StoreError):
        pull(tmp_path / "robot", "home", url)
    assert left.exists()
    (tmp_path / "kept").rename(tmp_path / "place/home/CURRENT")
    for path in (tmp_path / "place/home/files").iterdir():
        path.write_bytes(b"")  # no pull ends here, and none is as long as its name says
    with pytest.raises(StoreError, match="is not the file of this hash"):
        pull(tmp_path / "robot", "home", url)
    assert not left.exists()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("https://robot:pass@host/tables", "https://host/tables"),
        ("https://robot:pa#ss@host/tables", "https://host/tables"),
        ("https://robot:pa?ss@host/tables?token=1", "https://host/tables"),
        ("hf://datasets/user/name@main/", "hf://datasets/user/name@main"),
    ],
)
def test_no_password_is_shown(url, said):
    assert shown(url) == said


@pytest.mark.parametrize("url", ["http://[::1/tables", "https://host:99999999/t", "file:///a%00b"])
def test_what_is_no_url_is_one_line(built, url):
    with pytest.raises(InputError) as raised:
        push(built, "home", url)
    assert "\n" not in str(raised.value)


def test_a_folder_of_this_machine_may_be_named_with_its_host(built, tmp_path):
    push(built, "home", f"file://localhost{tmp_path}/place")
    assert pull(tmp_path / "robot", "home", f"file://{tmp_path}/place").new


def test_an_index_of_another_hash_is_never_put_into_a_folder_that_is_there(built, tmp_path):
    url = f"file://{tmp_path}/place"
    push(built, "home", url)
    pull(tmp_path / "robot", "home", url)
    (index,) = (tmp_path / "place/home/versions").iterdir()
    index.write_text(json.dumps(json.loads(index.read_text()), indent=1))
    digest = hashlib.sha256(index.read_bytes()).hexdigest()
    (tmp_path / "place/home/CURRENT").write_text(f"{index.stem} {digest}\n")
    with pytest.raises(StoreError, match="names no version"):
        pull(tmp_path / "robot", "home", url)
    assert SpaceFolder(tmp_path / "robot", "home").current().verify() is None
