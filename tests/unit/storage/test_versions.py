import hashlib
import json
import subprocess
import sys

import pytest

from roomtables.errors import StoreError
from roomtables.storage.files import build_lock, write_aside
from roomtables.storage.removal import remove_old
from roomtables.storage.versions import MANIFEST, SpaceFolder, Version
from support import made_manifest


def publish(space, fingerprint="abcdef0123", **manifest):
    with space.staging() as staging:
        (staging / "x.parquet").write_text("data")
        found = made_manifest(staging, **manifest)
        return space.publish(staging, space.new_name(fingerprint), found)


def test_a_published_version_is_current(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    version = publish(space, scorer_id="here")
    assert space.current().name == version.name == "000001-abcdef01"
    assert space.current().manifest == version.manifest
    assert version.manifest.scorer_id == "here"
    digest = hashlib.sha256((version.path / MANIFEST).read_bytes()).hexdigest()
    assert (space.path / "CURRENT").read_text() == f"000001-abcdef01 {digest}\n"
    assert (version.path / "x.parquet").read_text() == "data"
    assert [path.name for path in space.path.iterdir() if path.name.startswith(".staging")] == []


def test_an_opened_version_outlives_the_next_publish(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    opened = publish(space)
    publish(space)
    assert (opened.path / "x.parquet").read_text() == "data"
    assert space.current().name == "000002-abcdef01"


def test_two_versions_are_kept(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    names = [publish(space).name for _ in range(4)]
    remove_old(space)
    assert [path.name for path in space.versions()] == names[-2:]


def test_nothing_is_published_when_staging_fails(tmp_path):
    space = SpaceFolder(tmp_path, "home")

    def interrupted():
        with space.staging() as staging:
            (staging / "half").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(space.path.iterdir()) == []


def test_tables_that_are_not_there_name_the_next_command(tmp_path):
    publish(SpaceFolder(tmp_path, "office"))
    with pytest.raises(StoreError, match=r"there are tables for office.*roomtables build"):
        SpaceFolder(tmp_path, "home").current()


@pytest.mark.parametrize("name", ["gone", "", "../home", "."])
def test_a_current_that_names_nothing(tmp_path, name):
    space = SpaceFolder(tmp_path, "home")
    publish(space)
    (space.path / "CURRENT").write_text(name)
    with pytest.raises(StoreError, match="CURRENT names"):
        space.current()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "damaged"),
        ("[]", "damaged"),
        (json.dumps({"schema_version": 999}), "schema version 999"),
        ("{}", "schema version None"),
    ],
)
def test_a_manifest_that_cannot_be_read(tmp_path, text, said):
    version = publish(SpaceFolder(tmp_path, "home"))
    (version.path / MANIFEST).write_text(text)
    with pytest.raises(StoreError, match=said):
        Version.open(version.path)


def test_a_manifest_that_was_edited_is_not_the_published_one(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    path = publish(space).path / MANIFEST
    text = path.read_text()
    path.write_text(text.replace('"prior_weight": 0.5', '"prior_weight": 0.25'))
    assert path.read_text() != text
    with pytest.raises(StoreError, match=r"not the one that CURRENT names.*roomtables build"):
        space.current()
    path.write_text(text)
    assert space.current().path == path.parent


def test_tables_of_the_schema_before_say_so_in_one_line(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    version = publish(space)
    (space.path / "CURRENT").write_text(f"{version.name}\n")
    with pytest.raises(StoreError, match=r"lacks its manifest's hash.*what is scored is kept"):
        space.current()
    (version.path / MANIFEST).write_text('{"schema_version": 1}')
    with pytest.raises(StoreError, match=r"schema version 1, this roomtables reads 2.*kept"):
        space.current()
    assert space.named_by_current() == version.path


def test_what_current_names_is_never_removed_even_if_it_cannot_be_opened(tmp_path):
    space = SpaceFolder(tmp_path, "home")
    versions = [publish(space) for _ in range(4)]
    space.point_at(versions[0].path)
    (versions[0].path / MANIFEST).write_text("{}")
    assert list(remove_old(space)) == [versions[1].name]
    assert versions[0].path.is_dir()


def test_one_build_at_a_time(tmp_path):
    again = "import sys, pathlib; from roomtables.storage.files import build_lock\n"
    again += "with build_lock(pathlib.Path(sys.argv[1])): print('in')"
    with build_lock(tmp_path):
        run = subprocess.run(
            [sys.executable, "-c", again, tmp_path], capture_output=True, text=True, check=False
        )
        assert "is being built by" in run.stderr
    run = subprocess.run(
        [sys.executable, "-c", again, tmp_path], capture_output=True, text=True, check=True
    )
    assert run.stdout == "in\n"


def test_writing_aside_replaces_whole(tmp_path):
    path = tmp_path / "x"
    write_aside(path, b"one")
    write_aside(path, b"two")
    assert path.read_bytes() == b"two"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(StoreError, match="cannot write"):
        write_aside(tmp_path / "absent" / "x", b"")
