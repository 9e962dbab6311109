"""An archive for a robot opens like the tables it came from, and answers the same."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import threading
from itertools import combinations
from pathlib import Path

import pyarrow as pa
import pytest
from click.testing import CliRunner

from roomtables import RoomTables, build
from roomtables.cli import main
from roomtables.errors import InputError, ModelError, StoreError
from roomtables.storage.export import export
from roomtables.storage.lookup import Lookup
from roomtables.storage.versions import SpaceFolder, Version
from support import HashScorer, small_space, write_space

EVERY = [
    list(names)
    for size in (1, 2, 3, 4)
    for names in combinations(["bed", "sink", "stove", "toilet"], size)
]


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("export")
    counts = root / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,3\nsink,kitchen,2\n", encoding="utf-8")
    labels = str(write_space(root / "labels", small_space()))
    build(tables=root / "tables", scorer=HashScorer(), labels=labels, counts=counts)
    return root / "tables"


def unpack(archive: Path, folder: Path) -> Path:
    content = archive.read_bytes()
    if archive.name.endswith(".zst"):
        content = pa.CompressedInputStream(pa.BufferReader(content), "zstd").read()
    with tarfile.open(fileobj=io.BytesIO(content)) as members:
        assert members.getnames()[-1].endswith("CURRENT")  # so that a reader sees all or nothing
        members.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize("name", ["robot.tar.zst", "robot.tar.gz", "robot.tar"])
def test_an_unpacked_archive_answers_the_same(tables: Path, tmp_path: Path, name: str) -> None:
    sizes = export(tables, "small", tmp_path / name)
    assert [(s.source, s.combinations, s.rooms) for s in sizes] == [
        ("ground_truth", 14, 3), ("proxy", 14, 3)
    ]  # fmt: skip
    folder = unpack(tmp_path / name, tmp_path / "robot")
    SpaceFolder(folder / "tables", "small").current().verify()
    for source in ("proxy", "ground_truth"):
        for rule in ("query", "calibrated", "pooled"):
            here = RoomTables.open(tables, "small", source=source, rule=rule, verify=True)
            there = RoomTables.open(folder, "small", source=source, rule=rule, verify=True)
            pairs = zip(here.classify_many(EVERY), there.classify_many(EVERY), strict=True)
            for names, (one, other) in zip(EVERY, pairs, strict=True):
                assert one.as_json() == other.as_json() == there.classify(names).as_json()


def test_archives_hold_nothing_of_this_machine_and_do_not_change(
    tables: Path, tmp_path: Path
) -> None:
    for name in ("a.tar", "b.tar"):
        export(tables, "small", tmp_path / name)
    assert (tmp_path / "a.tar").read_bytes() == (tmp_path / "b.tar").read_bytes()
    with tarfile.open(tmp_path / "a.tar") as members:
        assert {(m.uid, m.gid, m.uname, m.gname) for m in members} == {(0, 0, "", "")}


def test_the_command_says_the_size_of_each_source(tables: Path, tmp_path: Path) -> None:
    archive = tmp_path / "robot.tar.zst"
    command = ["export", "-o", str(archive), "--tables", str(tables), "--labels", "small"]
    lines = CliRunner().invoke(main, command).output.splitlines()
    assert [line.split(":")[0] for line in lines] == ["ground_truth", "proxy", str(archive)]
    assert "14 combinations x 3 rooms" in lines[0]


def test_bad_requests_leave_nothing_behind(tables: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.tar\.zst"):
        export(tables, "small", tmp_path / "robot.zip")
    with pytest.raises(StoreError, match="no tables for nowhere"):
        export(tables, "nowhere", tmp_path / "robot.tar")
    with pytest.raises(StoreError, match="cannot write"):
        export(tables, "small", tmp_path / "no" / "such" / "folder.tar")
    assert list(tmp_path.iterdir()) == []


def test_a_model_is_packed_beside_the_tables_and_noted(tables: Path, tmp_path: Path) -> None:
    def write_model(version: Version, lookup: Lookup, folder: Path) -> None:
        assert [label.label for label in lookup.objects] == ["bed", "sink", "stove", "toilet"]
        (folder / "model.onnx").write_bytes(version.name.encode())

    export(tables, "small", tmp_path / "robot.tar", write_model)
    folder = unpack(tmp_path / "robot.tar", tmp_path / "robot")
    version = SpaceFolder(folder / "tables", "small").current()
    written_for = (version.path / "model" / "model.onnx").read_text()
    assert version.name.startswith(f"{written_for}-")
    assert "model/model.onnx" in version.manifest.files
    version.verify()


def test_a_model_that_cannot_be_written_leaves_nothing_behind(tables: Path, tmp_path: Path) -> None:
    def refuse(version: Version, lookup: Lookup, folder: Path) -> None:
        (folder / "model.onnx").write_bytes(b"half")
        raise ModelError("no")

    with pytest.raises(ModelError, match="no"):
        export(tables, "small", tmp_path / "robot.tar", refuse)
    assert list(tmp_path.iterdir()) == []


def test_zstd_tools_read_the_archive(tables: Path, tmp_path: Path) -> None:
    export(tables, "small", tmp_path / "robot.tar.zst")
    ran = subprocess.run(
        ["tar", "--zstd", "-tf", str(tmp_path / "robot.tar.zst")], capture_output=True, text=True
    )
    if ran.returncode and "zstd" in ran.stderr:
        pytest.skip("there is no zstd program here")
    assert "tables/small/CURRENT" in ran.stdout.split()


def test_a_robot_without_pyarrow_reads_what_was_unpacked(tables: Path, tmp_path: Path) -> None:
    export(tables, "small", tmp_path / "robot.tar")
    unpack(tmp_path / "robot.tar", tmp_path / "robot")
    code = (
        "import sys\n"
        "for name in ('pyarrow', 'duckdb', 'torch', 'transformers'): sys.modules[name] = None\n"
        "from roomtables import RoomTables\n"
        "print(RoomTables.open(sys.argv[1], 'small').classify(['sink']).room)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "robot")]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert found == RoomTables.open(tables, "small").classify(["sink"]).room
    manifest = json.loads(next(tmp_path.rglob("manifest.json")).read_text(encoding="utf-8"))
    assert all(name.startswith("lookup/") for name in manifest["files"])


def test_archives_of_one_name_and_other_content_do_not_meet_when_unpacked(
    tables: Path, tmp_path: Path
) -> None:
    """Two builds of the same inputs, whose model was not quite the same."""
    space = SpaceFolder(tables, "small")
    export(tables, "small", tmp_path / "one.tar")
    other = shutil.copytree(tables, tmp_path / "other")
    version = SpaceFolder(other, "small").current()
    noted = json.loads((version.path / "manifest.json").read_text(encoding="utf-8"))
    noted["created"] = "2020-01-01T00:00:00+00:00"
    (version.path / "manifest.json").write_text(json.dumps(noted), encoding="utf-8")
    SpaceFolder(other, "small").point_at(version.path)
    export(other, "small", tmp_path / "other.tar")
    for name in ("one.tar", "one.tar", "other.tar"):
        unpack(tmp_path / name, tmp_path / "robot")
    found = SpaceFolder(tmp_path / "robot" / "tables", "small")
    assert len(found.versions()) == 2
    assert all(path.name.startswith(f"{space.current().name}-") for path in found.versions())
    for path in found.versions():
        found.point_at(path).verify()


def test_an_archive_goes_into_a_pipe(tables: Path, tmp_path: Path) -> None:
    export(tables, "small", tmp_path / "robot.tar")
    pipe = tmp_path / "pipe.tar"
    os.mkfifo(pipe)
    heard: list[bytes] = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_bytes()))
    reader.start()
    export(tables, "small", pipe)
    reader.join()
    assert heard == [(tmp_path / "robot.tar").read_bytes()]
    assert pipe.is_fifo()


LINKED = [
    "manifest.json",
    "entropy.parquet",
    "lookup",
    "lookup/lookup.json",
    "lookup/proxy.scores.npy",
]


@pytest.mark.parametrize("name", LINKED)
def test_a_link_inside_a_version_is_refused(tables: Path, tmp_path: Path, name: str) -> None:
    copied = shutil.copytree(tables, tmp_path / "tables")
    space = SpaceFolder(copied, "small")
    path = space.current().path / name
    path.rename(path.with_name(f"moved-{path.name}"))
    path.symlink_to(f"moved-{path.name}")
    options = ["--tables", str(copied), "--labels", "small"]
    for command in (
        ["classify", "bed", "--offline"],
        ["status", "--verify"],
        ["export", "-o", str(tmp_path / "robot.tar")],
    ):
        found = CliRunner().invoke(main, [*command, *options])
        assert (found.exit_code, found.stderr.count("\n")) == (1, 1)
        assert f"{path} is a symbolic link" in found.stderr
    assert not (tmp_path / "robot.tar").exists()
