"""Spark-DSG graphs: traps of real files, label spaces, names written back, and bad input."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomtables.errors import InputError
from roomtables.rooms import Room
from roomtables.scenes import read_rooms, read_scene
from roomtables.scenes.dsg import NamedRoom, label_rooms
from roomtables.scenes.dsg_graph import parse_graph, rooms_of
from roomtables.scenes.scene import Box, ReadOptions
from scene_builders import UNSET, box, graph, node, node_id

LABELS = {0: "unknown", 1: "bed", 2: "oven"}


def write(folder: Path, document: dict[str, Any]) -> Path:
    path = folder / "scene_dsg.json"
    path.write_text(json.dumps(document))
    return path


def flat() -> dict[str, Any]:
    """A bedroom whose bed hangs on a place, a kitchen whose oven hangs on the room itself."""
    nodes = [node("R0"), node("R1"), node("p0"), node("O0", 1), node("O1", 2), node("a0")]
    return graph(nodes, [("R0", "p0"), ("O0", "p0"), ("R1", "O1"), ("p0", "a0")], LABELS)


def test_objects_reach_rooms_through_places_and_agents_are_no_objects(tmp_path: Path) -> None:
    rooms = list(read_rooms(write(tmp_path, flat())))
    assert rooms == [Room("R0", ("bed",)), Room("R1", ("oven",))]


def test_the_direction_of_an_edge_does_not_matter(tmp_path: Path) -> None:
    document = flat()
    for edge in document["edges"]:
        edge["source"], edge["target"] = edge["target"], edge["source"]
    assert list(read_rooms(write(tmp_path, document))) == [
        Room("R0", ("bed",)),
        Room("R1", ("oven",)),
    ]


@settings(deadline=None)
@given(
    rooms=st.dictionaries(st.integers(10, 14), st.sets(st.integers(100, 102)), min_size=1),
    direct=st.sets(st.integers(100, 102)),
    own=st.lists(st.integers(8, 16), unique=True),
    places=st.dictionaries(st.integers(8, 16), st.floats(0, 9)),
)
def test_rooms_of_agrees_with_counting_every_path(
    rooms: dict[int, set[int]], direct: set[int], own: list[int], places: dict[int, float]
) -> None:
    """Object 1 under places 8…16, some of which lie in rooms 100…102, or in rooms itself."""
    parents = {1: [*own, *sorted(direct)], **{place: sorted(r) for place, r in rooms.items()}}

    def distance(child: int, parent: int) -> float:
        return places.get(parent, 5.0)

    [found] = rooms_of([1], lambda n: parents.get(n, ()), lambda n: n >= 100, distance).values()
    paths = [
        (room, via)
        for via in parents[1]
        for room in ([via] if via >= 100 else parents.get(via, ()))
    ]
    scores = {
        room: (
            -sum(r == room for r, _ in paths),
            min(distance(1, v) for r, v in paths if r == room),
        )
        for room, _ in paths
    }
    assert found == min(scores, key=lambda room: (*scores[room], room), default=None)


def test_edges_within_a_layer_and_circles_of_edges_lead_nowhere(tmp_path: Path) -> None:
    document = flat()
    extra = graph([], [("R0", "R1"), ("p0", "R0"), ("R0", "p0"), ("R1", "R0"), ("O0", "O0")])
    document["edges"] += extra["edges"]
    assert [room.objects for room in read_rooms(write(tmp_path, document))] == [("bed",), ("oven",)]


def test_a_room_without_objects_stays_and_loose_objects_are_reported(tmp_path: Path) -> None:
    document = graph([node("R0"), node("p0"), node("O0", 1)], [("p0", "O0")], LABELS)
    warnings: list[str] = []
    scene = read_scene(write(tmp_path, document), ReadOptions(warn=warnings.append))
    assert [room.as_room() for room in scene.rooms] == [Room("R0", ())]
    assert [thing.object_id for thing in scene.unassigned] == ["O0"]
    assert warnings == ["scene_dsg: 1 of 1 objects lies in no room: O0 (bed)"]


@pytest.mark.parametrize(
    ("parents", "room"),
    [
        (["p1", "p2", "p0"], "R1"),  # two of three parents lead there
        (["p0", "p1"], "R1"),  # one each: p1 is nearer
        (["p0", "p3"], "R0"),  # one each, equally near: the lower id
    ],
)
def test_of_several_parents_most_then_nearest_then_lowest_wins(
    tmp_path: Path, parents: list[str], room: str
) -> None:
    nodes = [
        node("R0"),
        node("R1"),
        node("p0", position=[4.0, 0.0, 0.0]),
        node("p1", position=[1.0, 0.0, 0.0]),
        node("p2", position=[9.0, 0.0, 0.0]),
        node("p3", position=[0.0, 4.0, 0.0]),
        node("O0", 1),
    ]
    edges = [("R0", "p0"), ("R1", "p1"), ("R1", "p2"), ("R1", "p3")]
    document = graph(nodes, edges + [(parent, "O0") for parent in parents], LABELS)
    holding = [found.room_id for found in read_rooms(write(tmp_path, document)) if found.objects]
    assert holding == [room]


@pytest.mark.parametrize(
    ("label", "rooms", "truth"),
    [
        (UNSET, {1: "bedroom"}, ()),
        (-1, {1: "bedroom"}, ()),
        (0, {0: "unknown", 1: "bedroom"}, ()),
        (21, {1: "bedroom"}, ()),
        (1, {1: "bedroom"}, ("bedroom",)),
        (1, {1: "dining room;kitchen"}, ("dining room", "kitchen")),
        (0, None, ()),
        (21, None, ()),
        (UNSET, None, ()),
        (97, None, ("bathroom",)),
        (ord("D"), None, ("dining room",)),
        (ord("z"), None, ()),
        (98, {1: "bedroom"}, ()),  # a label space of its own: letters mean nothing
    ],
)
def test_true_rooms_come_from_the_label_and_unset_ones_are_none(
    tmp_path: Path, label: int, rooms: dict[int, str] | None, truth: tuple[str, ...]
) -> None:
    document = graph([node("R0", label)], [], LABELS, rooms)
    assert [room.truth for room in read_rooms(write(tmp_path, document))] == [truth]


def test_letters_count_only_where_every_labelled_room_holds_one(tmp_path: Path) -> None:
    document = graph([node("R0", 97), node("R1", 3)], [], LABELS)
    assert [room.truth for room in read_rooms(write(tmp_path, document))] == [(), ()]


def test_what_roomtables_wrote_is_not_the_truth(tmp_path: Path) -> None:
    mark = {"roomtables": {"rule": "query"}}
    document = graph([node("R0", 1, metadata=mark)], [], LABELS, {1: "bedroom"})
    assert next(read_rooms(write(tmp_path, document))).truth == ()


def test_names_come_from_the_yaml_given_then_the_objects_then_the_mesh(tmp_path: Path) -> None:
    document = graph([node("R0"), node("O0", 1)], [("R0", "O0")], LABELS)
    spaces = document["metadata"]["labelspaces"]
    yaml = tmp_path / "space.yaml"
    yaml.write_text("label_names: [{label: 1, name: sofa}]\n")
    path = write(tmp_path, document)
    assert next(read_rooms(path, labelspace=yaml)).objects == ("sofa",)
    spaces["mesh"] = [[1, "mesh bed"]]
    assert next(read_rooms(write(tmp_path, document))).objects == ("bed",)
    del spaces["_l2p0"]
    assert next(read_rooms(write(tmp_path, document))).objects == ("mesh bed",)


def test_without_label_space_the_error_says_how_to_give_one(tmp_path: Path) -> None:
    document = flat()
    document["metadata"] = {}
    with pytest.raises(InputError, match=r"no label space .*--labelspace FILE\.yaml"):
        list(read_rooms(write(tmp_path, document)))


def test_labels_that_the_graph_does_not_name_are_left_out_and_reported(tmp_path: Path) -> None:
    nodes = [node("R0"), node("O0", 1), node("O1", UNSET), node("O2", 7)]
    edges = [("R0", "O0"), ("R0", "O1"), ("R0", "O2")]
    warnings: list[str] = []
    path = write(tmp_path, graph(nodes, edges, LABELS))
    assert next(read_rooms(path, warn=warnings.append)).objects == ("bed",)
    assert len(warnings) == 1
    assert "2 of 3 objects left out" in warnings[0]


def test_a_yaml_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    yaml = tmp_path / "space.yaml"
    yaml.write_text("label_names: [{label: 9, name: sofa}]\n")
    with pytest.raises(InputError, match="does not name label 1 of object O0"):
        list(read_rooms(write(tmp_path, flat()), labelspace=yaml))


def old_generation() -> dict[str, Any]:
    """No header, no label space, ``layer_ids``, boxes by corners, no partition."""
    corners = {"type": "AABB", "min": [0.0, 0.0, 0.0], "max": [2.0, 2.0, 2.0]}
    nodes = [node("R0", 0, name="R(0)"), node("O0", 1, name="O(0)", bounding_box=corners)]
    for value in nodes:
        del value["partition"], value["attributes"]["metadata"]
    document = graph(nodes, [("R0", "O0")])
    del document["SPARK_DSG_header"], document["metadata"]
    return document | {"layer_ids": [2, 3, 4, 5], "mesh_edges": [], "mesh_layer_id": 1}


def test_the_old_generation_is_read_with_a_yaml(tmp_path: Path) -> None:
    yaml = tmp_path / "space.yaml"
    yaml.write_text("label_names: [{label: 1, name: bed}]\n")
    [room] = read_scene(write(tmp_path, old_generation()), ReadOptions(labelspace=yaml)).rooms
    assert room.as_room() == Room("R0", ("bed",))
    assert room.objects[0].box == Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0))


def test_boxes_are_read_around_a_turned_box_and_invalid_ones_are_none(tmp_path: Path) -> None:
    turned = box((0, 0, 0), (4, 2, 1))
    turned["world_R_center"] = {"w": 0.5**0.5, "x": 0.0, "y": 0.0, "z": 0.5**0.5}  # 90° about z
    invalid = box((0, 0, 0), (1, 1, 1)) | {"type": "INVALID"}
    nodes = [node("R0", bounding_box=turned), node("R1", bounding_box=invalid)]
    one, two = read_scene(write(tmp_path, graph(nodes, [], LABELS))).rooms
    assert one.box is not None
    assert one.box.low == pytest.approx((1, -1, 0))
    assert one.box.high == pytest.approx((3, 3, 1))
    assert two.box is None


def _nan_box(document: dict[str, Any]) -> None:
    document["nodes"][0]["attributes"]["bounding_box"] = box((0, 0, 0), (1, 1, float("nan")))


def _null_box(document: dict[str, Any]) -> None:
    corners = {"type": "AABB", "min": [0, 0, None], "max": [1, 1, 1]}
    document["nodes"][0]["attributes"]["bounding_box"] = corners


def _large_id(document: dict[str, Any]) -> None:
    document["nodes"][0]["id"] = 2**64


def _text_id(document: dict[str, Any]) -> None:
    document["nodes"][0]["id"] = "R0"


def _double_id(document: dict[str, Any]) -> None:
    document["nodes"].append(copy.deepcopy(document["nodes"][0]))


def _loose_edge(document: dict[str, Any]) -> None:
    document["edges"][0]["target"] = 5


def _no_rooms(document: dict[str, Any]) -> None:
    document["nodes"] = [value for value in document["nodes"] if value["layer"] != 4]


def _strange_space(document: dict[str, Any]) -> None:
    document["metadata"]["labelspaces"]["_l2p0"] = [3]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_nan_box, r"scene_dsg\.json: invalid JSON \(NaN\)"),
        (_null_box, "node R0: box is not three finite numbers"),
        (_large_id, "does not fit 64 bits"),
        (_text_id, r"nodes\[0\]: expected id, layer and attributes"),
        (_double_id, r"\(R0\) occurs twice"),
        (_loose_edge, r"edges\[0\]: no node has the id 5"),
        (_no_rooms, "no node in the ROOMS layer"),
        (_strange_space, "label space _l2p0 is not a list"),
    ],
)
def test_damaged_graphs_are_refused(tmp_path: Path, damage: Any, message: str) -> None:
    document = flat()
    damage(document)
    with pytest.raises(InputError, match=message):
        list(read_rooms(write(tmp_path, document)))


def test_a_truncated_graph_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, flat())
    path.write_text(path.read_text()[:-40])
    with pytest.raises(InputError, match=r"invalid JSON .* cut short"):
        list(read_rooms(path))


def named(document: dict[str, Any], **rooms: str) -> dict[str, Any]:
    labelled = copy.deepcopy(document)
    answers = {
        key: NamedRoom(label, {label: 0.9, "office": 0.1}, {"rule": "query", "model": "m"})
        for key, label in rooms.items()
    }
    label_rooms(parse_graph(labelled, "test"), answers, ["bedroom", "kitchen", "office"])
    return labelled


def test_naming_rooms_changes_nothing_but_the_labels() -> None:
    document = flat()
    labelled = named(document, R0="bedroom")
    attributes = labelled["nodes"][0]["attributes"]
    assert attributes.pop("name") == "bedroom"
    assert attributes.pop("semantic_label") == 1
    assert attributes.pop("semantic_class_probabilities") == {"bedroom": 0.9, "office": 0.1}
    assert attributes.pop("metadata") == {"roomtables": {"rule": "query", "model": "m"}}
    spaces = labelled["metadata"]["labelspaces"]
    assert spaces.pop("_l4p0") == [[0, "unknown"], [1, "bedroom"], [2, "kitchen"], [3, "office"]]
    for key in ("name", "semantic_label", "metadata"):
        del document["nodes"][0]["attributes"][key]
    assert labelled == document


def test_a_graphs_own_room_labels_keep_their_ids_and_missing_ones_are_added() -> None:
    document = graph([node("R0"), node("R1")], [], LABELS, {0: "unknown", 5: "kitchen;pantry"})
    labelled = named(document, R0="pantry", R1="bedroom")
    assert [value["attributes"]["semantic_label"] for value in labelled["nodes"]] == [5, 6]
    spaces = labelled["metadata"]["labelspaces"]
    assert spaces["_l4p0"] == [[0, "unknown"], [5, "kitchen;pantry"], [6, "bedroom"]]


def test_without_answers_nothing_changes() -> None:
    assert named(flat()) == flat()


NAMED = {"rule": "query", "label": "kitchen"}  # what roomtables notes of a room it has named


def renamed(name: str, provenance: Any, **options: Any) -> tuple[dict[str, Any], int]:
    """The only room of a graph, which has a name and loses its answer or gets another."""
    room = node("R7", 2, name=name, metadata={"roomtables": provenance, "from": "elsewhere"})
    room["attributes"]["semantic_class_probabilities"] = {"kitchen": 1.0}
    document = graph([room], [], LABELS, {0: "unknown", 2: "kitchen"})
    answers = {"R7": NamedRoom("bedroom", {})} if options.pop("answered", False) else {}
    count = label_rooms(parse_graph(document, "test"), answers, ["bedroom", "kitchen"], **options)
    found: dict[str, Any] = document["nodes"][0]["attributes"]
    return found, count


def test_without_an_answer_roomtables_own_name_is_taken_back() -> None:
    found, count = renamed("kitchen", NAMED)
    assert (found["name"], found["semantic_label"], count) == ("R7", 0, 0)
    assert found["semantic_class_probabilities"] == {}
    assert found["metadata"] == {"from": "elsewhere"}


@pytest.mark.parametrize(
    ("name", "provenance"),
    [("canteen", NAMED), ("kitchen", {}), ("kitchen", [1]), ("kitchen", {"label": ["kitchen"]})],
)
def test_without_an_answer_a_name_that_another_gave_stays(name: str, provenance: Any) -> None:
    found, _ = renamed(name, provenance)
    assert (found["name"], found["semantic_label"]) == (name, 2)
    assert found["semantic_class_probabilities"] == {"kitchen": 1.0}


@pytest.mark.parametrize(
    ("name", "provenance", "kept"),
    [
        ("canteen", NAMED, True),
        ("kitchen", {}, True),
        ("kitchen", NAMED, False),
        ("R7", {}, False),
        ("R(7)", {}, False),  # as older versions of Hydra wrote it
        ("", {}, False),
    ],
)
def test_names_that_others_gave_can_be_kept(name: str, provenance: Any, kept: bool) -> None:
    found, count = renamed(name, provenance, answered=True, keep_names=True)
    assert (found["name"], count) == ((name, 0) if kept else ("bedroom", 1))
    assert renamed(name, provenance, answered=True)[0]["name"] == "bedroom"


def test_naming_the_same_rooms_again_changes_nothing() -> None:
    once = named(flat(), R0="bedroom", R1="kitchen")
    assert named(once, R0="bedroom", R1="kitchen") == once


@pytest.mark.parametrize("name", ["two_room_dsg.json", "apartment_dsg.json"])
def test_real_graphs_come_back_from_spark_dsg_with_their_labels(
    shared_data: Path, tmp_path: Path, name: str
) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    original = json.loads((shared_data / "scene_graphs" / name).read_text())
    labelled = named(original, R0="kitchen")
    path = tmp_path / name
    path.write_text(json.dumps(labelled))
    loaded = spark_dsg.DynamicSceneGraph.load(path)
    room = loaded.get_node(node_id("R0")).attributes
    assert room.name == "kitchen"
    assert loaded.get_labelspace(4, 0).labels_to_names[room.semantic_label] == "kitchen"
    assert room.semantic_class_probabilities == pytest.approx({"kitchen": 0.9, "office": 0.1})
    assert room.metadata.get()["roomtables"]["model"] == "m"
    assert loaded.num_nodes() == len(original["nodes"])


def test_rooms_of_real_graphs_agree_with_spark_dsg(shared_data: Path) -> None:
    """The same objects as ``spark_dsg`` finds under each room by its own walk."""
    spark_dsg = pytest.importorskip("spark_dsg")
    folder = shared_data / "scene_graphs"
    yaml = folder / "label_spaces" / "uhumans2_apartment_label_space.yaml"
    for name, labelspace in (("two_room_dsg.json", None), ("apartment_dsg.json", yaml)):
        loaded = spark_dsg.DynamicSceneGraph.load(folder / name)
        for room in read_scene(folder / name, ReadOptions(labelspace=labelspace)).rooms:
            below, todo = set(), [node_id(room.room_id)]
            while todo:
                children = loaded.get_node(todo.pop()).children()
                below |= set(children)
                todo += children
            objects = {n.id.value for n in loaded.get_layer("OBJECTS").nodes}
            assert {node_id(thing.object_id) for thing in room.objects} == below & objects


def test_sparkdsg_files_read_as_their_json(shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("spark_dsg")
    folder = shared_data / "scene_graphs"
    assert list(read_rooms(folder / "two_room_dsg.sparkdsg")) == list(
        read_rooms(folder / "two_room_dsg.json")
    )
    damaged = tmp_path / "damaged.sparkdsg"
    damaged.write_bytes((folder / "two_room_dsg.sparkdsg").read_bytes()[:900])
    with pytest.raises(InputError, match=r"not a readable \.sparkdsg file"):
        list(read_rooms(damaged))
