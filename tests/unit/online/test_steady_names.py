"""Live names that hold: hysteresis, names that others gave, names that are taken back."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from roomtables.errors import ConfigError
from roomtables.online.classifier import RoomTables
from roomtables.online.steady_names import SteadyNames
from tiny_tables import build_tables

KITCHEN, BEDROOM, OFFICE = ["oven", "fridge"], ["bed", "lamp"], ["chair"]


@dataclass
class Seen:
    """A scene as `SteadyNames` sees it."""

    rooms: Mapping[str, Sequence[str]]
    names: dict[str, str] = field(default_factory=dict)
    ours: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.names = {key: self.names.get(key, key) for key in self.rooms}

    @property
    def unnamed(self) -> frozenset[str]:
        return frozenset(key for key, name in self.names.items() if name == key)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> RoomTables:
    folder = build_tables(tmp_path_factory.mktemp("built"))
    return RoomTables.open(folder, "flat", offline=True, note_misses=False)


class Robot:
    """Sees rooms again and again; tells the name that room R0 is given."""

    def __init__(self, tables: RoomTables, **options: Any) -> None:
        self.now = 0.0
        self.tables = tables
        self.names = SteadyNames(clock=lambda: self.now, **options)

    def sees(self, objects: Sequence[str], name: str = "R0", ours: bool = False) -> str | None:
        """The name given, ``R0`` where that is given back; ``None`` where it is left alone."""
        scene = Seen({"R0": objects}, {"R0": name}, frozenset(["R0"] if ours else []))
        named = self.names.settle(scene, {"R0": self.tables.classify(objects)})
        return (named["R0"].label or "R0") if "R0" in named else None


def lead(tables: RoomTables, objects: Sequence[str], best: str, other: str) -> float:
    """By how many nats one room leads another, from the probabilities that are shown."""
    found = tables.classify(objects).probabilities
    return math.log(found[best]) - math.log(found[other])


def test_without_margin_or_hold_names_follow_every_change(tables: RoomTables) -> None:
    for options in ({"margin": 0.0, "hold": 100}, {"margin": 1e9, "hold": 1}):
        robot = Robot(tables, **options)
        found = [robot.sees(objects) for objects in (KITCHEN, BEDROOM, OFFICE, KITCHEN)]
        assert found == ["kitchen", "bedroom", "office", "kitchen"]


def test_a_name_changes_at_once_from_the_margin_on(tables: RoomTables) -> None:
    leads = lead(tables, BEDROOM, "bedroom", "kitchen")
    assert leads > 0
    for margin, name in ((leads - 0.01, "bedroom"), (leads + 0.01, "kitchen")):
        robot = Robot(tables, margin=margin, hold=10)
        robot.sees(KITCHEN)
        assert robot.sees(BEDROOM) == name


def test_below_the_margin_a_name_changes_when_it_is_best_in_a_row(tables: RoomTables) -> None:
    robot = Robot(tables, margin=1e9, hold=3)
    robot.sees(KITCHEN)
    assert [robot.sees(BEDROOM) for _ in range(2)] == ["kitchen"] * 2
    robot.sees(KITCHEN)  # begins anew
    assert [robot.sees(BEDROOM) for _ in range(2)] == ["kitchen"] * 2
    assert robot.sees(OFFICE) == "kitchen"  # so does another challenger
    found = [robot.sees(BEDROOM) for _ in range(4)]
    assert found == ["kitchen", "kitchen", "bedroom", "bedroom"]


def test_noise_flips_names_far_less_often(tables: RoomTables) -> None:
    """Each object is missed every fifth time, and a stranger is seen every fifth."""
    chance, things = random.Random(5), ["bed", "lamp", "oven", "fridge", "chair"]
    seen = []
    for _ in range(400):
        objects = [name for name in KITCHEN if chance.random() > 0.2]
        seen.append(objects + ([chance.choice(things)] if chance.random() < 0.2 else []))

    def flips(robot: Robot) -> int:
        names = [robot.sees(objects) for objects in seen]
        return sum(a != b for a, b in pairwise(names))

    assert flips(Robot(tables)) <= 2 < 20 < flips(Robot(tables, margin=0, hold=1))


def test_a_room_whose_objects_are_gone_loses_the_name_after_hold_updates(
    tables: RoomTables,
) -> None:
    robot = Robot(tables, hold=3)
    robot.sees(KITCHEN)
    found = [robot.sees([], name="kitchen") for _ in range(4)]  # as Hydra copied it
    assert found == ["kitchen", "kitchen", "R0", "R0"]
    assert robot.sees([], name="R0") is None
    assert robot.sees(KITCHEN) == "kitchen"


def test_only_a_name_that_is_from_here_is_taken_back(tables: RoomTables) -> None:
    assert Robot(tables).sees([], name="kitchen") is None  # who knows who gave it
    assert Robot(tables).sees(["zorb"], name="kitchen", ours=True) == "R0"
    robot = Robot(tables, hold=1)
    robot.sees(KITCHEN)
    assert robot.sees([], name="Mia's room") is None


def test_names_that_others_gave_are_kept_where_that_is_asked_for(tables: RoomTables) -> None:
    robot = Robot(tables, keep_names=True)
    assert robot.sees(KITCHEN, name="R0") == "kitchen"
    assert robot.sees(KITCHEN, name="kitchen") == "kitchen"  # our own, copied by Hydra
    assert robot.sees(KITCHEN, name="canteen") is None
    assert robot.sees(KITCHEN, name="R0") == "kitchen"
    assert Robot(tables, keep_names=True).sees(KITCHEN, name="canteen") is None
    assert Robot(tables, keep_names=True).sees(KITCHEN, name="bar", ours=True) == "kitchen"
    assert Robot(tables).sees(KITCHEN, name="canteen") == "kitchen"


def test_an_unsure_answer_takes_the_name_only_after_hold_updates(tables: RoomTables) -> None:
    robot = Robot(tables.deciding(min_probability=0.999), hold=2)
    assert robot.sees(OFFICE) is None  # too unsure to begin with
    best = tables.classify(KITCHEN).probability
    assert best is not None
    sure = Robot(tables.deciding(min_probability=best - 0.001), margin=1e9, hold=2)
    assert sure.sees(KITCHEN) == "kitchen"
    unsure = ["oven", "bed", "chair"]
    assert sure.tables.classify(unsure).room is None
    assert [sure.sees(unsure) for _ in range(2)] == ["kitchen", None]


def test_a_better_answer_to_the_same_objects_is_taken_at_once(tables: RoomTables) -> None:
    """As when the model answers what was decided without it."""
    names, scene = SteadyNames(margin=1e9, hold=100), Seen({"R0": KITCHEN})
    names.settle(scene, {"R0": tables.classify(BEDROOM)})
    found = names.settle(scene, {"R0": tables.classify(KITCHEN)}, new=False)
    assert found["R0"].label == "kitchen"


def test_the_same_scene_again_is_no_update(tables: RoomTables) -> None:
    names = SteadyNames(margin=1e9, hold=3)
    names.settle(Seen({"R0": KITCHEN}), {"R0": tables.classify(KITCHEN)})
    scene, answers = Seen({"R0": BEDROOM}), {"R0": tables.classify(BEDROOM)}
    found = [names.settle(scene, answers, new=at == 0)["R0"] for at in range(9)]
    assert {name.label for name in found} == {"kitchen"}
    assert all(name.held for name in found)
    assert names.unsettled
    names.settle(scene, answers)
    assert names.settle(scene, answers)["R0"].label == "bedroom"
    assert not names.unsettled


def test_a_room_that_is_gone_for_long_is_forgotten(tables: RoomTables) -> None:
    for minutes, name in ((5, "kitchen"), (11, "bedroom")):
        robot = Robot(tables, margin=1e9, hold=9)
        robot.sees(KITCHEN)
        robot.now += 60 * minutes
        robot.names.settle(Seen({}), {})
        assert robot.sees(BEDROOM) == name


def test_what_is_remembered_is_bounded(tables: RoomTables) -> None:
    robot = Robot(tables, margin=1e9, hold=9)
    robot.sees(KITCHEN)
    answer = tables.classify(OFFICE)
    for start in range(0, 20_000, 100):
        rooms = {f"R{at}": OFFICE for at in range(start + 1, start + 101)}
        robot.names.settle(Seen(rooms), dict.fromkeys(rooms, answer))
    assert robot.sees(BEDROOM) == "bedroom"  # forgotten, as it was the oldest


@pytest.mark.parametrize("options", [{"margin": -1.0}, {"margin": float("nan")}, {"hold": 0}])
def test_numbers_that_make_no_sense_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        SteadyNames(**options)


def test_a_held_name_is_told_in_the_published_graph(tables: RoomTables, tmp_path: Path) -> None:
    pytest.importorskip("spark_dsg")
    import live_graphs
    from scene_builders import node_id

    graphs = live_graphs.graph_labeller(tables, names=SteadyNames(margin=1e9, hold=2))

    def room(message: bytes | None) -> Any:
        assert message is not None
        graph = live_graphs.spark_dsg.DynamicSceneGraph.from_binary(message)
        return graph.get_node(node_id("R0")).attributes

    graphs.take(live_graphs.live_graph(live_graphs.KITCHEN).to_binary())
    bedroom = live_graphs.live_graph(live_graphs.BEDROOM).to_binary()
    first = room(graphs.take(bedroom))
    noted = first.metadata.get()["roomtables"]
    assert (first.name, noted["held"], noted["best"]) == ("kitchen", True, "bedroom")
    assert noted["probability"] == pytest.approx(first.semantic_class_probabilities["kitchen"])
    assert graphs.counters.rooms == {"held": 1}
    second = room(graphs.take(bedroom))  # the same message again is another update
    assert second.name == "bedroom"
    assert "held" not in second.metadata.get()["roomtables"]
