"""The model that the wheel brings answers what no table holds, without torch."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from robot_tables import publish
from roomtables import RoomTables
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel

pytest.importorskip("onnxruntime", reason="the model runs on ONNX Runtime (extra `robot`)")
pytest.importorskip("tokenizers", reason="the model reads text by tokenizers (extra `robot`)")

OBJECTS = ("bed", "microwave", "oven", "refrigerator", "toilet", "towel")
SPACE = LabelSpace(
    "robot",
    tuple(ObjectLabel(label, f"{label}s") for label in OBJECTS),
    tuple(RoomLabel(label, "a") for label in ("bathroom", "bedroom", "kitchen")),
)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of the model's own single-object scores, which hold no combination."""
    from roomtables.lm.folders import EMBEDDED_FOLDER
    from roomtables.onnx_lm import MODEL_FILE, OnnxScorer

    folder = tmp_path_factory.mktemp("tables")
    publish(folder, SPACE, OnnxScorer.open(EMBEDDED_FOLDER / MODEL_FILE), held=())
    return folder


def test_a_missing_combination_is_asked_of_the_model(tables: Path) -> None:
    before = "torch" in sys.modules
    found = RoomTables.open(tables, "robot").classify(["refrigerator", "microwave", "oven"])
    assert (found.room, found.answered_by, found.rule) == ("kitchen", "lm", "query")
    assert ("torch" in sys.modules) == before


def test_without_it_the_tables_of_single_objects_decide(tables: Path) -> None:
    opened = RoomTables.open(tables, "robot", offline=True)
    found = opened.classify(["refrigerator", "microwave", "oven"])
    assert (found.room, found.answered_by, found.rule) == ("kitchen", "table", "pooled")


def test_an_unknown_name_costs_a_question_more(tables: Path) -> None:
    found = RoomTables.open(tables, "robot").classify(["shampoo", "towel"])
    assert (found.room, found.answered_by) == ("bathroom", "lm")
    assert found.unknown_objects == ()
