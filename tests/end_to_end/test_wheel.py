"""What is built for others: the source distribution, the wheel made of it, an editable install."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from wheels import hatch

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "roomtables"
PIPELINE = ROOT / "pipeline"
IMPORT = """
import json, roomtables.config as config
labels = {name: len(config.load_labels(name).objects) for name in config.builtin_labels()}
print(json.dumps([str(config.pipeline_folder()), config.BuildConfig.load().model, labels]))
"""


def files(folder):
    """The files under a folder, relative to it, without what Python caches."""
    found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return {name for name in found if "__pycache__" not in name}


def test_the_source_distribution_holds_every_committed_file(source):
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("this is no git checkout, so nothing says which files are committed")
    committed = {name for name in listed.stdout.split("\0") if name and (ROOT / name).exists()}
    assert len(committed) > 200
    assert committed <= files(source)


def test_the_wheel_holds_the_pipeline_without_the_training_of_the_model(installed):
    found = files(installed / "roomtables" / "pipeline")
    expected = {name for name in files(PIPELINE) if not name.startswith("household_lm/")}
    assert found == expected
    assert {"build.toml", "entropy.sql", "labels/mpcat40/objects.csv"} <= found
    assert not [name for name in files(installed) if "household_lm" in name]


def test_the_wheel_holds_the_package_with_the_model_and_nothing_else(installed):
    package = {f"roomtables/{name}" for name in files(PACKAGE)}
    assert "roomtables/models/household-lm/model.safetensors" in package
    others = files(installed) - package
    assert package <= files(installed)
    assert all(name.startswith("roomtables/pipeline/") or ".dist-info/" in name for name in others)


def test_the_installed_package_reads_the_pipeline_that_it_brings(installed, tmp_path):
    run = subprocess.run(
        [sys.executable, "-c", IMPORT],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(installed)},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    folder, model, labels = json.loads(run.stdout)
    assert Path(folder) == installed / "roomtables" / "pipeline"
    assert model == "household-lm"
    assert labels["mpcat40"] == 35


def test_an_editable_install_copies_nothing(tmp_path):
    with zipfile.ZipFile(hatch(ROOT, "wheel:editable", tmp_path)) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
        assert [Path(name).suffix for name in names] == [".pth"]
        assert Path(archive.read(names[0]).decode().strip()) == ROOT / "src"
