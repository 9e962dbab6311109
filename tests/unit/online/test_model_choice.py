"""Which model answers what no table holds, and what is said where none does."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from roomtables import Prediction, RoomTables, build
from roomtables.config import BuildConfig
from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.lm import identities, load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.online import model
from roomtables.online.model import QueryModel
from roomtables.onnx_lm import MODEL_FILE, TOKENIZER_FILE, OnnxScorer
from roomtables.rooms import Room
from roomtables.scenes.reader import read_rooms
from roomtables.scorer import Scorer, SentenceScore
from roomtables.storage.manifest import FileFacts, Manifest
from support import HashScorer, made_manifest, small_space, write_space

MISS = ["bed", "sink", "stove"]
OF_HOUSEHOLD_LM = identities("household-lm")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of household-lm that hold no combination."""
    root = tmp_path_factory.mktemp("model_choice")
    labels = str(write_space(root / "labels", small_space()))
    build(tables=root / "tables", labels=labels, combinations="none", device="cpu")
    return root / "tables"


def manifest(tmp_path: Path, **changes: object) -> Manifest:
    found = {"scorer_id": OF_HOUSEHOLD_LM[0], "query_scorer_id": OF_HOUSEHOLD_LM[0]}
    return made_manifest(tmp_path, **found | changes)


def beside(version: Path) -> Path:
    """household-lm in ONNX, where an export puts it."""
    folder = version / "model"
    folder.mkdir(parents=True)
    for name in (MODEL_FILE, TOKENIZER_FILE):
        shutil.copy(EMBEDDED_FOLDER / name, folder)
    return folder


def test_the_packaged_file_answers_for_tables_that_its_model_scored(tables: Path) -> None:
    found = RoomTables.open(tables, "small").classify(MISS)
    torch = RoomTables.open(tables, "small", scorer=load_scorer()).classify(MISS)
    assert (found.room, found.answered_by) == (torch.room, "lm")
    assert found.probabilities == pytest.approx(torch.probabilities, abs=1e-3)


def test_too_little_memory_for_the_model_leaves_the_tables_to_decide(tables: Path) -> None:
    code = f"""
import resource
from roomtables import RoomTables
from roomtables.memory import address_space_used
import onnxruntime, tokenizers
opened = RoomTables.open({str(tables)!r}, "small")
most = address_space_used() + (2 << 20)
resource.setrlimit(resource.RLIMIT_AS, (most, most))
found = opened.classify({MISS!r})
print(found.rule, found.answered_by, found.backed_off)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout == "pooled table True\n", ended.stderr
    assert ended.stderr.count("no language model here") == 1
    assert len(ended.stderr.splitlines()) == 1


def test_a_miss_runs_without_torch(tables: Path) -> None:
    code = (
        "import sys\n"
        "from roomtables import RoomTables\n"
        "print(RoomTables.open(sys.argv[1], 'small').classify(sys.argv[2:]).answered_by)\n"
        "print(*{'torch', 'transformers', 'pyarrow', 'duckdb'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", code, str(tables), *MISS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("lm\n\n", "")


def test_onnx_runtime_tells_nobody_of_a_session(tables: Path, tmp_path: Path) -> None:
    """Its telemetry, on by default but where ``CI`` is set, leaves a file where it begins."""
    code = (
        "import sys; from roomtables import RoomTables\n"
        "print(RoomTables.open(sys.argv[1], 'small').classify(sys.argv[2:]).answered_by)\n"
    )
    unset = {"CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS"}
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    command = [sys.executable, "-c", code, str(tables), *MISS]
    environment["TMPDIR"] = str(tmp_path)
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout == "lm\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scored_by", OF_HOUSEHOLD_LM)
def test_the_device_that_scored_the_tables_does_not_matter(tmp_path: Path, scored_by: str) -> None:
    found = QueryModel(manifest(tmp_path, scorer_id=scored_by, query_scorer_id=scored_by)).load()
    assert isinstance(found, OnnxScorer)


def test_a_file_beside_the_tables_comes_first(tmp_path: Path) -> None:
    folder = beside(tmp_path / "space" / "000001")
    found = QueryModel(manifest(folder.parent), version=folder.parent).load()
    assert isinstance(found, OnnxScorer)
    assert str(folder) in str(found.path)


def test_imported_scores_go_with_the_model_of_the_settings(tmp_path: Path) -> None:
    imported = {"scorer_id": "imported-0123456789ab", "query_scorer_id": None}
    assert isinstance(QueryModel(manifest(tmp_path, **imported)).load(), OnnxScorer)
    half = BuildConfig(dtype="float16")
    found = QueryModel(manifest(tmp_path, **imported, settings=half)).load()
    assert found is not None
    assert not isinstance(found, OnnxScorer)


def test_another_model_answers_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    other = manifest(tmp_path, scorer_id="household-lm@0", query_scorer_id="household-lm@0")
    asked = QueryModel(other)
    assert [asked.load(), asked.load(), asked.score([])] == [None] * 3
    (warning,) = caplog.messages
    assert "household-lm@0" in warning
    assert OF_HOUSEHOLD_LM[0] in warning
    assert "roomtables build" in warning


def test_a_model_that_is_not_here_answers_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = BuildConfig(model=str(tmp_path / "nowhere"))
    gone = manifest(tmp_path, query_scorer_id="nowhere@1", settings=settings)
    assert QueryModel(gone).load() is None
    (warning,) = caplog.messages
    assert "no model folder" in warning
    assert "\n" not in warning


@pytest.mark.parametrize("damaged", [MODEL_FILE, TOKENIZER_FILE])
@pytest.mark.parametrize("noted", [True, False])
def test_where_the_file_beside_is_damaged_the_packaged_one_answers(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damaged: str, noted: bool
) -> None:
    folder = beside(tmp_path / "space" / "000001")
    files = {f"model/{path.name}": FileFacts.of(path) for path in folder.iterdir()}
    content = (folder / damaged).read_bytes()
    (folder / damaged).write_bytes(content[: len(content) // 2])
    about = manifest(folder.parent, files=files if noted else {})
    found = QueryModel(about, version=folder.parent).load()
    assert isinstance(found, OnnxScorer)
    (warning,) = caplog.messages
    assert str(folder) in warning


def test_a_link_out_of_the_tables_is_not_followed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = beside(tmp_path / "elsewhere")
    version = tmp_path / "tables" / "space" / "000001"
    version.mkdir(parents=True)
    (version / "model").symlink_to(folder)
    assert QueryModel(manifest(version, files={}), version=version).load() is not None
    (warning,) = caplog.messages
    assert "symbolic link" in warning


FORBID = "import sys\nfor name in {names!r}: sys.modules[name] = None\n"
WARNED = (
    "from roomtables import RoomTables\n"
    "tables = RoomTables.open(sys.argv[1], 'small', rule='query')\n"
    "for _ in range(2): tables.classify(sys.argv[2:])"
)


@pytest.mark.parametrize(
    ("absent", "advice"),
    [
        (("onnxruntime", "torch"), "roomtables[robot]"),
        (("tokenizers", "torch", "transformers"), "roomtables[robot]"),
    ],
)
def test_what_to_install_is_said_once(tables: Path, absent: Sequence[str], advice: str) -> None:
    command = [sys.executable, "-c", FORBID.format(names=absent) + WARNED, str(tables), *MISS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr.count(advice) == done.stderr.count("no language model here") == 1


def test_torch_answers_where_onnx_runtime_is_absent(
    tables: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # an import then says "not installed"
    opened = RoomTables.open(tables, "small")
    assert opened.classify(MISS).answered_by == "lm"
    assert not isinstance(QueryModel(opened.version.manifest).load(), OnnxScorer)
    assert "no language model" not in caplog.text


class Slow(HashScorer):
    """Lets other threads run while it scores."""

    def score(self, sentences: Sequence[str]) -> list[SentenceScore]:
        threading.Event().wait(0.01)
        return super().score(sentences)


ROOMS = tuple(RoomLabel(f"room {number}", "a") for number in range(3))


def objects(*names: str) -> list[ObjectLabel]:
    return [ObjectLabel(name, f"{name}s") for name in names]


def test_a_combination_is_asked_once_under_threads_too(tmp_path: Path) -> None:
    scorer = Slow()
    asked = QueryModel(made_manifest(tmp_path), scorer)
    queries = [(objects("bed", "lamp"), ROOMS), (objects("lamp", "bed"), ROOMS)]
    answers: list[list[np.ndarray] | None] = []
    threads = [
        threading.Thread(target=lambda: answers.append(asked.score(queries))) for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(scorer.asked) == len(set(scorer.asked)) == 6
    for found in answers:
        assert found is not None
        for answer, (names, _) in zip(found, queries, strict=True):
            text = " and ".join(label.plural for label in names)
            sentences = [f"A room containing {text} is called a {r.label}." for r in ROOMS]
            assert answer.tolist() == [scorer.score_of(one).log_prob for one in sentences]
            with pytest.raises(ValueError, match="read-only"):
                answer[0] = 0.0


def test_one_call_asks_what_is_new_and_repeats_nothing(tmp_path: Path) -> None:
    scorer = HashScorer()
    asked = QueryModel(made_manifest(tmp_path), scorer)
    first = (objects("bed"), ROOMS)
    asked.score([first])
    found = asked.score([first, (objects("lamp"), ROOMS), first, (objects("bed"), ROOMS[:2])])
    assert found is not None
    assert [len(answer) for answer in found] == [3, 3, 3, 2]
    assert found[0].tolist() == found[2].tolist() == [*found[3].tolist(), found[0][2]]
    assert len(scorer.asked) == 3 + 3 + 2


def test_memory_of_answers_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "MOST_ANSWERS", 2)
    scorer = HashScorer()
    asked = QueryModel(made_manifest(tmp_path), scorer)
    queries = [(objects(name), ROOMS) for name in "abc"]
    found = asked.score(queries)  # more in one call than are kept
    assert found is not None
    assert len(found) == 3
    asked.score(queries[1:])
    assert len(scorer.asked) == 9
    asked.score(queries[:1])
    assert len(scorer.asked) == 12


@pytest.fixture(scope="module")
def mpcat40(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("mpcat40")
    build(tables=root, labels="mpcat40", combinations="none", device="cpu")
    return root


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_real_rooms_are_answered_as_torch_answers_them(
    mpcat40: Path, shared_data: Path, every: int
) -> None:
    files = ["matterport3d/mpcat40_rooms_test.jsonl", "ai2thor/ai2thor_rooms.jsonl"]
    rooms: list[Room] = [room for file in files for room in read_rooms(shared_data / file)]
    assert len(rooms) == 523 + 120
    rooms = rooms[::every]
    options = {"rule": "query", "note_misses": False}
    scorers: list[Scorer] = [OnnxScorer.open(EMBEDDED_FOLDER), load_scorer()]
    found: list[list[Prediction]] = []
    for scorer in scorers:
        tables = RoomTables.open(mpcat40, "mpcat40", scorer=scorer, **options)
        found.append(list(tables.classify_many([room.objects for room in rooms])))
    for one, other in zip(*found, strict=True):
        assert one.room == other.room
        assert one.objects == other.objects
        assert one.probabilities == pytest.approx(other.probabilities, abs=1e-3)
    assert sum(one.answered_by == "lm" for one in found[0]) > 0.9 * len(rooms)
