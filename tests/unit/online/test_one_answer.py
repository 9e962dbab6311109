"""The same graph through classify, label, Python and serve gives the same rooms."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from roomtables import RoomTables, build
from roomtables.cli import main
from roomtables.online.model_thread import ModelThread
from roomtables.scenes.reader import read_rooms

spark_dsg = pytest.importorskip("spark_dsg")

from live_graphs import graph_labeller, live_graph  # noqa: E402
from roomtables.scenes.live import GraphCodec  # noqa: E402

NAMES = {
    1: "toilet", 2: "sink", 3: "towel", 4: "refrigerator", 5: "microwave", 6: "bed", 7: "Chair",
    8: "laptop", 9: "counter", 10: "zorb", 11: "sofa", 12: "oven", 13: "dining_table", 14: "",
}  # fmt: skip
ROOMS = [
    (1, 2, 3), (4, 5, 12), (6,), (7, 8, 10), (9, 4), (10,), (), (11, 7, 9, 2), (13, 7), (14, 6),
]  # fmt: skip


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of the embedded model, whose query scores are those of a few combinations only."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "rooms.jsonl").write_text(
        '{"room_id": "a", "objects": ["toilet", "sink", "towel"]}\n'
        '{"room_id": "b", "objects": ["counter"]}\n'
    )
    combinations = str(folder / "rooms.jsonl")
    build(tables=folder / "tables", labels="mpcat40", combinations=combinations)
    return folder / "tables"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A graph of rooms with known and unknown names, and none."""
    path = tmp_path_factory.mktemp("made") / "made.json"
    live_graph(*ROOMS, labels=NAMES).save(path)
    return path


@pytest.fixture(params=["made", "two_room_dsg", "apartment_dsg"])
def scene(request: pytest.FixtureRequest) -> Iterator[tuple[Path, Path | None]]:
    """A graph, and the label space that names its labels if it does not."""
    if request.param == "made":
        return request.getfixturevalue("made"), None
    folder = request.getfixturevalue("shared_data") / "scene_graphs"
    yaml = folder / "label_spaces" / "uhumans2_apartment_label_space.yaml"
    return folder / f"{request.param}.json", yaml if request.param == "apartment_dsg" else None


def run(*arguments: object) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def by_serve(
    scene: Path, yaml: Path | None, opened: RoomTables, model: ModelThread | None
) -> bytes:
    """The graph that serve publishes once all its questions are answered."""
    graphs = graph_labeller(opened, model, codec=GraphCodec(yaml))
    published = graphs.take(spark_dsg.DynamicSceneGraph.load(scene).to_binary())
    deadline = time.monotonic() + 90
    while model is not None and model.waiting:
        assert time.monotonic() < deadline
        published = graphs.take_model_answers() or published
        time.sleep(0.01)
    published = graphs.take_model_answers() or published
    graphs.close()
    assert published is not None
    return spark_dsg.DynamicSceneGraph.from_binary(published)


@pytest.mark.parametrize("offline", [True, False], ids=["tables", "model"])
def test_one_graph_has_one_answer(
    scene: tuple[Path, Path | None], tables: Path, offline: bool, tmp_path: Path
) -> None:
    path, yaml = scene
    options = ["--tables", tables, "--labels", "mpcat40", *(["--offline"] if offline else [])]
    options += ["--labelspace", yaml] if yaml else []

    lines = run("classify", "--input", path, "--format", "jsonl", *options).splitlines()
    classified = {line["room_id"]: line["room"] for line in map(json.loads, lines)}

    opened = RoomTables.open(tables, "mpcat40", offline=offline)
    rooms = list(read_rooms(path, labelspace=yaml, warn=lambda _: None))
    assert {room.room_id: opened.classify(room.objects).room for room in rooms} == classified
    together = opened.classify_many([room.objects for room in rooms]).rooms
    assert dict(zip([room.room_id for room in rooms], together, strict=True)) == classified

    run("label", path, "-o", tmp_path / "labelled.json", *options)
    labelled = json.loads((tmp_path / "labelled.json").read_text())
    alone = RoomTables.open(tables, "mpcat40", offline=True)
    model = None if offline else ModelThread(RoomTables.open(tables, "mpcat40"))
    served = by_serve(path, yaml, alone, model)
    for key, room in classified.items():
        number = ord("R") << 56 | int(key[1:])
        [entry] = [node["attributes"] for node in labelled["nodes"] if node["id"] == number]
        attributes = served.get_node(number).attributes
        for found, metadata in (
            (entry, entry.get("metadata") or {}),
            ({"name": attributes.name}, attributes.metadata.get()),
        ):
            label = metadata.get("roomtables", {}).get("label")
            assert (found["name"], label) == ((room, room) if room else (found["name"], None))
    if not offline and len(classified) > 2:
        assert sum(room is None for room in classified.values()) == 1  # the empty one


def test_more_unknown_names_than_are_asked_about_are_the_same_in_any_order(tables: Path) -> None:
    opened = RoomTables.open(tables, "mpcat40")
    names = [f"zorb {letter}{other}" for letter in "abcdefgh" for other in "ijklmnopq"]
    answers = [opened.classify(["sink", *given]) for given in (names, names[::-1])]
    assert len(names) > 50
    assert answers[0].answered_by == answers[1].answered_by == "lm"
    assert answers[0].objects == answers[1].objects
    assert answers[0].compared == pytest.approx(answers[1].compared)
