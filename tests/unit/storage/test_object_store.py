"""Tables and misses travel through an object store that speaks S3, on loopback."""

import socket
import threading
import time
from datetime import timedelta

import pytest

from robot_tables import publish
from roomtables import RoomTables
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.storage.miss_log import FOLDER, MissLog
from roomtables.storage.misses import Misses
from roomtables.storage.place import PATIENCE
from roomtables.storage.places import open_place
from roomtables.storage.pulling import pull
from roomtables.storage.pushing import push, read_pointer
from roomtables.storage.sent_misses import fetch_misses, send_misses
from roomtables.storage.versions import SpaceFolder
from support import HashScorer

WHY = "`make test-object-store` installs them, where nothing else holds them back"
moto_server = pytest.importorskip("moto.server", reason=f"moto is not installed: {WHY}")
s3fs = pytest.importorskip("s3fs", reason=f"s3fs is not installed: {WHY}")

SPACE = LabelSpace.named("home", ["bed", "sink", "stove", "toilet"], ["bathroom", "kitchen"])
URL = "s3://bucket/tables"


@pytest.fixture(scope="module")
def server():
    running = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def store(server, monkeypatch):
    """An empty bucket; s3fs asks for its endpoint in the environment."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", server)
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.delenv("AWS_PROFILE", raising=False)
    system = s3fs.S3FileSystem(skip_instance_cache=True, use_listings_cache=False)
    system.mkdir("bucket")
    yield system
    system.rm("bucket", recursive=True)


@pytest.fixture
def built(tmp_path):
    tables = tmp_path / "built"
    publish(tables, SPACE, HashScorer())
    return tables


def scores(tables):
    return RoomTables.open(tables, "home", offline=True).classify(["bed", "sink"]).probabilities


def names(store, folder):
    path = f"bucket/tables/home/{folder}"
    return {found.rpartition("/")[2] for found in store.ls(path)} if store.exists(path) else set()


def test_what_arrives_answers_as_what_was_sent(store, built, tmp_path):
    first = push(built, "home", URL)
    assert first.moved
    assert first.files == len(names(store, "files"))
    assert pull(tmp_path / "robot", "home", URL).new
    assert scores(tmp_path / "robot") == scores(built)
    again = push(built, "home", URL)
    assert (again.files, again.moved) == (0, False)
    assert not pull(tmp_path / "robot", "home", URL).new


def test_only_what_changed_travels(store, built, tmp_path):
    first = push(built, "home", URL)
    pull(tmp_path / "robot", "home", URL)
    publish(built, SPACE, HashScorer(), prior_weight=0.25)
    second = push(built, "home", URL)
    assert 0 < second.files < first.files
    done = pull(tmp_path / "robot", "home", URL)
    assert done.bytes_fetched == second.bytes
    assert scores(tmp_path / "robot") == scores(built)


@pytest.mark.parametrize("change", [lambda b: b[:-1], lambda b: b[::-1], lambda b: b""])
def test_a_wrong_object_changes_nothing(store, built, tmp_path, change):
    robot = tmp_path / "robot"
    push(built, "home", URL)
    pull(robot, "home", URL)
    publish(built, SPACE, HashScorer("other@1"))
    push(built, "home", URL)
    before = scores(robot)
    for name in names(store, "files"):
        path = f"bucket/tables/home/files/{name}"
        store.pipe_file(path, change(store.cat_file(path)))
    with pytest.raises(StoreError):
        pull(robot, "home", URL)
    assert scores(robot) == before


def test_a_cut_pull_goes_on_where_it_was(store, built, tmp_path):
    push(built, "home", URL)
    largest = max(store.ls("bucket/tables/home/files", detail=True), key=lambda o: o["size"])
    whole = store.cat_file(largest["name"])
    store.pipe_file(largest["name"], whole[: len(whole) // 2])
    with pytest.raises(StoreError):
        pull(tmp_path / "robot", "home", URL)
    store.pipe_file(largest["name"], whole)
    done = pull(tmp_path / "robot", "home", URL)
    sent = sum(each["size"] for each in store.ls("bucket/tables/home/files", detail=True))
    assert 0 < done.bytes_fetched <= sent - len(whole) // 2
    assert scores(tmp_path / "robot") == scores(built)


def test_old_versions_go_and_the_published_one_stays(store, built, tmp_path, later):
    for weight in (0.1, 0.2, 0.3):
        publish(built, SPACE, HashScorer(), prior_weight=weight)
        push(built, "home", URL, keep=1)
    assert len(names(store, "versions")) == 3  # all written lately
    later(hours=2)
    assert push(built, "home", URL, keep=1).removed == 2
    assert len(names(store, "versions")) == 1
    pull(tmp_path / "robot", "home", URL)
    arrived = SpaceFolder(tmp_path / "robot", "home").current().manifest
    assert names(store, "files") == {facts.sha256 for facts in arrived.files.values()}


@pytest.fixture
def later(monkeypatch):
    """Let time pass: the store tells when an object was written, and no test can change that."""
    clock = time.time

    def pass_by(**length):
        monkeypatch.setattr(time, "time", lambda: clock() + timedelta(**length).total_seconds())

    return pass_by


def test_pushes_at_once_lose_no_version_that_is_named(store, tmp_path):
    """Each pusher moves the pointer; whichever comes last, its version is whole."""
    folders = []
    for number in range(4):
        folders.append(tmp_path / f"built{number}")
        publish(folders[-1], SPACE, HashScorer(f"model@{number}"), prior_weight=0.1 * number)
    failed = []

    def send(tables):
        try:
            for _ in range(2):
                push(tables, "home", URL, keep=1)
        except StoreError as error:
            failed.append(error)

    threads = [threading.Thread(target=send, args=(folder,)) for folder in folders]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if read_pointer(open_place(URL), "home"):
            pull(tmp_path / "robot", "home", URL)
            assert scores(tmp_path / "robot") in [scores(folder) for folder in folders]
    assert not failed
    pull(tmp_path / "robot", "home", URL)
    assert scores(tmp_path / "robot") in [scores(folder) for folder in folders]


def test_misses_come_home_once(store, built, tmp_path):
    push(built, "home", URL)
    robot = tmp_path / "robot"
    pull(robot, "home", URL)
    MissLog(robot / "home" / FOLDER).note("proxy", [["bed", "sink", "stove"], ["bed"]])
    assert send_misses(robot, "home", URL)[1:3] == (2, 1)
    assert send_misses(robot, "home", URL)[1:] == (0, 0, 0)
    store.pipe_file("bucket/tables/home/misses/notes.txt", b"not misses")
    assert fetch_misses(built, "home", URL)[::2] == (1, 1)
    found = {miss.objects for miss in Misses.read(built / "home" / FOLDER).open}
    assert found == {("bed", "sink", "stove"), ("bed",)}
    assert fetch_misses(built, "home", URL).files == 0


def test_a_bucket_that_is_not_there_is_one_line(store, built, tmp_path):
    with pytest.raises(StoreError, match="s3://absent/tables cannot be written"):
        push(built, "home", "s3://absent/tables")
    assert not store.exists("absent")
    with pytest.raises(StoreError, match="s3://absent/tables"):
        pull(tmp_path / "robot", "home", "s3://absent/tables")


def test_a_store_that_does_not_answer_is_one_line(built, store, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        began = time.monotonic()
        with pytest.raises(StoreError, match="no answer for 1 s"):
            push(built, "home", URL, patience=PATIENCE._replace(seconds=1))
        assert time.monotonic() - began < 10
