"""The nightly commands as a user types them."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from roomtables import build
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, small_space, write_space
from terminal import at_terminal


@pytest.fixture(scope="module")
def space(tmp_path_factory):
    return str(write_space(tmp_path_factory.mktemp("labels"), small_space()))


@pytest.fixture(scope="module")
def built(tmp_path_factory, space):
    """Tables of three builds."""
    folder = tmp_path_factory.mktemp("built")
    for k in (1, 2, 3):
        build(tables=folder, labels=space, scorer=HashScorer(), k=k)
    return folder


@pytest.fixture
def tables(built, tmp_path):
    """Those tables, to change."""
    return shutil.copytree(built, tmp_path / "t")


def test_plan_of_the_embedded_model_writes_nothing(shell, tmp_path):
    found = json.loads(shell("plan", "--tables", tmp_path / "t", "-k", 1, "--format", "json"))
    states = {stage["state"] for stage in found["stages"]}
    assert states == {"missing"}
    assert found["sentences_to_score"] == sum(stage["sentences"] for stage in found["stages"])
    assert "to score:" in shell("plan", "--tables", tmp_path / "t", "-k", 1)
    assert not (tmp_path / "t").exists()


# The peak of this process alone: ru_maxrss would take over that of the process it was forked from.
MEASURED = """
import json, re, sys
from pathlib import Path
from roomtables.cli import main
main(json.loads(sys.argv[1]), standalone_mode=False)
[peak] = re.findall(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())
heavy = sorted({"torch", "transformers"} & sys.modules.keys())
print(json.dumps([int(peak) / 1024, heavy]), file=sys.stderr)
"""


@pytest.mark.parametrize("labels", ["nyuclass", "many"])
def test_a_plan_by_formula_costs_little_whatever_the_label_space(tmp_path, labels):
    """No torch is imported where no GPU can be, and no table is made."""
    folder = tmp_path / "many"
    folder.mkdir()
    (folder / "objects.csv").write_text("object\n" + "".join(f"gadget {n}\n" for n in range(1200)))
    (folder / "rooms.csv").write_text("room\nkitchen\nbathroom\n")
    made = str(folder) if labels == folder.name else labels
    args = ["plan", "--tables", str(tmp_path / "t"), "--labels", made, "--combinations", "all"]
    command = [sys.executable, "-c", MEASURED, json.dumps(args)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    peak, heavy = json.loads(ended.stderr)
    assert "to score: at most" in ended.stdout
    assert peak < 300  # MB
    if not any(Path("/dev").glob("nvidia*")):
        assert heavy == []


def test_status_tells_old_from_new(shell, tables, space):
    options = ("--tables", tables, "--labels", space)
    shell("status", *options, "--max-age", "26h", "--verify")
    assert "more than 0 h" in shell("status", *options, "--max-age", "0s", code=1)
    shell("status", *options, "--max-age", "soon", code=2)
    manifest = next(tables.glob("small/0*3-*/manifest.json"))
    found = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(found | {"created": "2999-01-01T00:00:00+00:00"}))
    SpaceFolder(tables, "small").point_at(manifest.parent)
    assert "in the future" in shell("status", *options, "--max-age", "26h", code=1)
    (manifest.parent / "rooms.parquet").write_bytes(b"")
    assert "rooms.parquet is damaged" in shell("status", *options, "--verify", code=1)


def test_a_quiet_night_is_no_alarm(shell, tables, space):
    """Tables of long ago are up to date where a build has found them so since."""
    options = ("--tables", tables, "--labels", space)
    manifest = next(tables.glob("small/0*3-*/manifest.json"))
    found = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(found | {"created": "2026-01-01T00:00:00+00:00"}))
    SpaceFolder(tables, "small").point_at(manifest.parent)
    said = shell("status", *options, "--max-age", "26h", code=1)
    assert f"roomtables build --tables {tables} --labels {space}" in said
    assert json.loads(shell("status", *options, "--format", "json"))["checked"] is None
    assert not build(tables=tables, labels=space, scorer=HashScorer(), k=3).published
    shell("status", *options, "--max-age", "26h", "--verify")
    assert json.loads(shell("status", *options, "--format", "json"))["checked"]
    checked = tables / "small" / "CHECKED"
    checked.write_text(checked.read_text().replace("20", "29", 1))
    assert "in the future" in shell("status", *options, "--max-age", "26h", code=1)


def test_the_advice_is_the_command_that_made_the_tables(shell, tmp_path, space):
    tables = tmp_path / "my tables"
    counts = tmp_path / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,9\n")
    build(tables=tables, labels=space, scorer=HashScorer(), k=2, counts=counts, model="./gpt2")
    said = shell("status", "--tables", tables, "--labels", space, "--max-age", "0s", code=1)
    assert f"--tables '{tables}' --labels {space} --model ./gpt2 -k 2 --counts {counts}`" in said


def test_status_names_the_scorer_that_made_the_scores(shell, tmp_path, space):
    scores = tmp_path / "gptj.csv"
    rows = [f"{o.label},{r.label},-1\n" for o in small_space().objects for r in small_space().rooms]
    scores.write_text("object,room,log_prob\n" + "".join(rows))
    made = {"tables": tmp_path / "t", "labels": space, "scores": scores, "scorer": HashScorer()}
    options = ("--tables", tmp_path / "t", "--labels", space)
    for combinations, model in (("none", None), ("misses", None), ("all", "household-lm")):
        build(**made, combinations=combinations)
        found = json.loads(shell("status", *options, "--format", "json"))
        assert found["scorer_id"].startswith("imported-")
        assert (found["scores"], found["model"]) == (str(scores), model)
        assert ("household-lm" in shell("status", *options)) == (model is not None)


def test_tables_fit_80_columns(tmp_path):

    def shell(*arguments):
        shown = at_terminal(80, *arguments)
        assert shown.code == 0, shown
        return shown.terminal

    long = "a very long name of an object that stands in the hall"
    small = small_space("small")
    folder = write_space(tmp_path / "labels", small)
    options = ("--tables", tmp_path / "t", "--labels", folder)
    build(tables=tmp_path / "t", labels=str(folder), scorer=HashScorer(), k=1)
    said = [shell("plan", *options, "--counts", write_counts(tmp_path), "--reduction", "mean")]
    (folder / "objects.csv").write_text(f"object\n{long}\nanother {long}\nbed\nsink\n")
    for k in (2, 3):
        build(tables=tmp_path / "t", labels=str(folder), scorer=HashScorer(), k=k)
    said += [shell("plan", *options, "-k", 2)]
    first = min(path.name for path in (tmp_path / "t" / "small").glob("0*"))
    said += [shell("diff", first, *options), shell("status", *options)]
    (tmp_path / "t" / "small" / ".CURRENT.0123abcd.tmp").write_text("half")
    said += [shell("gc", "--tables", tmp_path / "t", "--keep", 1, "--unused-scores")]
    for text in said:
        assert max(map(len, text.splitlines())) <= 80, text


def write_counts(folder):
    path = folder / "counts.csv"
    path.write_text("object,room,count\nbed,bedroom,9\n")
    return path


def test_a_night_and_its_morning(shell, tables, space):
    options = ("--tables", tables, "--labels", space)
    merged = json.loads(shell("compact", "--tables", tables, "--format", "json"))
    assert [(row["parts_before"], row["parts_after"]) for row in merged] == [(3, 1)]
    found = json.loads(shell("diff", *options, "--format", "json"))
    assert (found["before"][:6], found["after"][:6]) == ("000002", "000003")
    assert found["objects"] == []
    assert found["combinations"][0]["added"] == 4
    assert "0 objects moved" in shell("diff", *options)
    left = json.loads(shell("rollback", *options, "--format", "json"))
    assert (left["version"][:6], left["left"][:6]) == ("000002", "000003")
    assert "nothing came before" in shell("rollback", *options, code=1)
    removed = json.loads(shell("gc", "--tables", tables, "--keep", 1, "--format", "json"))
    assert removed == []  # the published one is not the newest, and both stay
    assert shell("gc", "--tables", tables) == "nothing to remove\n"
    assert "no version 'x'" in shell("diff", "x", *options, code=1)


@pytest.mark.parametrize("command", ["gc", "compact", "rollback", "diff", "status"])
def test_without_tables(shell, tables, command):
    shutil.rmtree(tables)
    assert "roomtables build" in shell(command, "--tables", tables, code=1)
    assert not tables.exists()
