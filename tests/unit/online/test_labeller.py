"""Answers at once from the tables; the language model's, in a thread of its own, later."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from roomtables import build
from roomtables.errors import ModelError
from roomtables.online.classifier import RoomTables
from roomtables.online.labeller import Labeller
from roomtables.online.model_thread import ModelThread
from roomtables.scorer import SentenceScore
from tiny_tables import OBJECTS, FitScorer, build_tables, write_labels

SETS = [list(some) for k in (1, 2, 3) for some in combinations(sorted(OBJECTS), k)]


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables that hold no query combination at all."""
    return build_tables(tmp_path_factory.mktemp("sparse"), combinations="none")


@pytest.fixture(scope="module")
def opened(sparse: Path) -> RoomTables:
    return RoomTables.open(sparse, "flat", offline=True, note_misses=False)


class Gated(FitScorer):
    """Scores nothing until its gate is opened, and fails at sentences about some things."""

    def __init__(self, failing: str = "", error: type[Exception] = ModelError) -> None:
        super().__init__()
        self.gate = threading.Event()
        self.failing, self.error = failing, error
        self.sentences: list[str] = []

    def score(self, sentences: Sequence[str]) -> list[SentenceScore]:
        self.gate.wait(20)
        self.sentences += sentences
        if self.failing and any(self.failing in sentence for sentence in sentences):
            raise self.error("out of order")
        return super().score(sentences)


@pytest.fixture
def with_model(
    sparse: Path, opened: RoomTables
) -> Iterator[Callable[..., tuple[Labeller, ModelThread]]]:
    """Makes a labeller whose model is a scorer, and closes it in the end."""
    made = []

    def make(scorer: FitScorer, **options: Any) -> tuple[Labeller, ModelThread]:
        tables = RoomTables.open(sparse, "flat", scorer=scorer, note_misses=False)
        thread = ModelThread(tables, first_pause=0.05, **options)
        made.append(Labeller(opened, thread))
        return made[-1], thread

    yield make
    for labeller in made:
        labeller.close()


def until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 90  # importing torch may take long
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def answered_by_model(labeller: Labeller, objects: Sequence[str]) -> bool:
    labeller.take_model_answers()
    return labeller.label({"R0": objects})["R0"].answered_by == "lm"


def test_what_no_table_holds_is_backed_off_at_once_and_asked_of_the_model(with_model: Any) -> None:
    scorer = FitScorer()
    labeller, _ = with_model(scorer)
    first = labeller.label({"R0": ("oven", "fridge")})["R0"]
    assert (first.room, first.rule) == ("kitchen", "pooled")
    until(labeller.take_model_answers)
    second = labeller.label({"R0": ("fridge", "oven")})["R0"]
    assert (second.room, second.rule, second.answered_by) == ("kitchen", "query", "lm")
    assert scorer.calls == 1


def test_a_name_that_no_table_knows_is_asked_of_the_model(tmp_path: Path) -> None:
    """Also where the tables hold what the known ones make: it may be among the k that count."""
    tables = build_tables(tmp_path)
    asking = RoomTables.open(tables, "flat", scorer=FitScorer())
    labeller = Labeller(RoomTables.open(tables, "flat", offline=True), ModelThread(asking))
    objects = ["oven", "chair", "zorb"]
    first = labeller.label({"R0": objects})["R0"]
    assert (first.answered_by, first.unknown_objects) == ("table", ("zorb",))
    until(lambda: answered_by_model(labeller, objects))
    found, wanted = labeller.label({"R0": objects})["R0"], asking.classify(objects)
    assert (found.room, found.objects) == (wanted.room, wanted.objects)
    assert "zorb" in found.objects
    labeller.close()


def test_without_a_model_the_pooled_answer_stands(opened: RoomTables) -> None:
    labeller = Labeller(opened)
    answers = labeller.label({"R0": ("oven",), "R1": ()})
    assert answers["R0"].rule == "pooled"
    assert answers["R1"].room is None
    assert not labeller.take_model_answers()
    labeller.close()


def test_what_does_not_fit_among_the_waiting_is_asked_later(
    with_model: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Fault A10: each of 25 questions is answered in the end, though only three may wait."""
    scorer = Gated()
    labeller, thread = with_model(scorer, most_waiting=3)
    rooms = {f"R{at}": objects for at, objects in enumerate(SETS)}
    for _ in range(500):
        labeller.label(rooms)
    assert thread.waiting == 3
    assert labeller.unasked
    assert 1 <= caplog.text.count("questions behind") <= 3
    scorer.gate.set()

    def all_answered() -> bool:
        labeller.take_model_answers()
        return all(answer.answered_by == "lm" for answer in labeller.label(rooms).values())

    until(all_answered)
    assert not labeller.unasked
    assert thread.waiting == 0


def test_questions_that_wait_share_a_pass_and_none_is_asked_twice(with_model: Any) -> None:
    scorer = Gated()
    labeller, thread = with_model(scorer)
    rooms = {f"R{at}": objects for at, objects in enumerate(SETS)}
    for _ in range(3):
        labeller.label(rooms)
    scorer.gate.set()
    until(lambda: thread.waiting == 0)
    assert scorer.calls <= 2  # what came before the gate opened, and all the rest
    assert len(scorer.sentences) == len(set(scorer.sentences))


def test_names_that_are_read_alike_are_one_question(with_model: Any) -> None:
    scorer = Gated()
    labeller, thread = with_model(scorer)
    labeller.label({"R0": ["stove", "Bed"], "R1": ["oven", "bed"], "R2": ["ovens", "beds"]})
    assert thread.waiting == 1
    scorer.gate.set()
    for objects in (["stove", "Bed"], ["oven", "bed"], ["ovens", "beds"]):
        until(lambda objects=objects: answered_by_model(labeller, objects))
    assert scorer.calls == 1


@pytest.mark.parametrize("error", [ModelError, MemoryError, ValueError, RecursionError])
def test_a_question_that_the_model_fails_at_ends_itself_alone(
    with_model: Any, error: type[Exception], caplog: pytest.LogCaptureFixture
) -> None:
    scorer = Gated("oven", error)
    scorer.gate.set()
    labeller, thread = with_model(scorer)
    assert labeller.label({"R0": ["oven"], "R1": ["bed"]})["R0"].rule == "pooled"
    until(lambda: answered_by_model(labeller, ["bed"]))
    until(lambda: answered_by_model(labeller, ["chair"]))
    assert not answered_by_model(labeller, ["oven"])
    assert not thread.ended
    assert f"the model failed ({error.__name__}: out of order)" in caplog.text
    scorer.failing = ""
    until(lambda: answered_by_model(labeller, ["oven"]))  # it is asked again, after a pause


def test_a_model_that_does_not_load_is_told_once_and_asked_no_more(
    tmp_path: Path, opened: RoomTables, caplog: pytest.LogCaptureFixture
) -> None:
    """The tables name a model that is nowhere, as the scorer that built them was handed in."""
    labels, tables = str(write_labels(tmp_path)), tmp_path / "tables"
    nowhere = {"model": str(tmp_path / "nowhere"), "combinations": "none"}
    build(tables=tables, scorer=FitScorer(), labels=labels, **nowhere)
    labeller = Labeller(opened, ModelThread(RoomTables.open(tables, "flat")))
    told = "no language model here"
    until(lambda: bool(labeller.label({"R0": ["oven"]})) and told in caplog.text)
    for objects in SETS:
        assert labeller.label({"R0": objects})["R0"].rule == "pooled"
    assert caplog.text.count(told) == 1
    assert labeller.waiting == 0
    assert not labeller.unasked


def test_an_unchanged_room_is_not_decided_again(opened: RoomTables) -> None:
    class Counting:
        decision = opened.decision

        def __init__(self) -> None:
            self.asked = 0

        def classify(self, objects: list[str]) -> Any:
            self.asked += 1
            return opened.classify(objects)

        def deciding(self, **changes: Any) -> RoomTables:
            return opened.deciding(**changes)

    counting = Counting()
    labeller = Labeller(counting)  # type: ignore[arg-type]
    for _ in range(5):
        labeller.label({"R0": ("bed", "lamp"), "R1": ("lamp", "bed", "bed"), "R2": ("oven",)})
    assert counting.asked == 2
    labeller.label({"R0": ("bed", "lamp", "chair"), "R2": ("oven",)})
    assert counting.asked == 3


def test_unknown_names_are_counted_with_a_suggestion(opened: RoomTables) -> None:
    labeller = Labeller(opened, suggest=lambda name: ["chair"] if name == "chiar" else [])
    assert labeller.unknown_names.line() == ""
    labeller.label({"R0": ["bed", "chiar"], "R1": ["chiar"], "R2": ["zorb" * 30, "bed"]})
    labeller.label({"R0": ["bed", "chiar"]})  # the same objects count once
    assert labeller.unknown_names.line() == f"2 unknown names: chiar 2 (chair?), {'zorb' * 10}… 1"


def test_the_counts_of_unknown_names_are_bounded(opened: RoomTables) -> None:
    labeller = Labeller(opened)
    for at in range(3_000):
        labeller.label({"R0": [f"thing {at}", "often seen"]})
    line = labeller.unknown_names.line()
    assert "often seen 3000" in line
    assert int(line.split()[0]) <= 1_000


def test_answers_are_logged_nowhere_when_all_goes_well(
    opened: RoomTables, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    Labeller(opened).label({"R0": ["oven"]})
    assert caplog.text == ""
