"""rooms, label, show, labels import, and classify on scenes: what users type and read."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from roomtables.cli import main
from scene_builders import House, box, graph, node, node_id
from tiny_tables import build_tables

LABELS = {1: "Bed", 2: "lamp", 3: "stove", 4: "fridge", 5: "gizmo"}


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def lines(result: Result) -> list[dict[str, object]]:
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_tables(tmp_path_factory.mktemp("built"))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A bedroom, a kitchen that the graph calls an office, and a room that holds nothing."""
    nodes = [
        node("R0", 1, bounding_box=box((0, 0, 0), (4, 4, 3))),
        node("R1", 3),
        node("R2"),
        node("O0", 1, position=[1.0, 1.0, 0.5]),
        node("O1", 2, position=[2.0, 1.0, 0.5]),
        node("O2", 3, position=[6.0, 1.0, 0.5]),
        node("O3", 4, position=[7.0, 1.0, 0.5]),
        node("O4", 5, position=[7.5, 1.0, 0.5]),
        node("O5", 2),
    ]
    edges = [("R0", "O0"), ("R0", "O1"), ("R1", "O2"), ("R1", "O3"), ("R1", "O4")]
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(graph(nodes, edges, LABELS, {1: "bedroom", 3: "office"})))
    return path


@pytest.fixture
def house(tmp_path: Path) -> Path:
    built = House()
    bedroom = built.region("b", (0, 0, 0), (4, 4, 3))
    built.region("x", (10, 0, 0), (14, 4, 3))
    built.object(bedroom, built.category("bed", "bed"), (1, 1, 1))
    built.object(bedroom, built.category("refridgerator", "appliances"), (1, 1, 1))
    return built.write(tmp_path)


def test_rooms_prints_room_lines_and_reports_loose_objects(scene: Path) -> None:
    result = run("rooms", scene)
    assert lines(result) == [
        {"room_id": "R0", "room": "bedroom", "objects": ["Bed", "lamp"]},
        {"room_id": "R1", "room": "office", "objects": ["stove", "fridge", "gizmo"]},
        {"room_id": "R2", "objects": []},
    ]
    warning, unknown = result.stderr.splitlines()
    assert warning == "warning: scene: 1 of 6 objects lies in no room: O5 (lamp)"
    assert unknown.startswith("unknown to label space ")
    assert '"gizmo"' in unknown


def test_rooms_of_several_scenes_keep_ids_apart(scene: Path, house: Path) -> None:
    ids = [line["room_id"] for line in lines(run("rooms", scene, house))]
    assert ids == ["scene/R0", "scene/R1", "scene/R2", "house1/0"]


def test_rooms_nested(scene: Path, tmp_path: Path) -> None:
    result = run("rooms", scene, "--format", "nested", "-o", tmp_path / "nested.json")
    assert result.exit_code == 0
    document = json.loads((tmp_path / "nested.json").read_text())
    assert document["rooms"][0]["name"] == "bedroom"
    assert document["rooms"][0]["objects"][0] == {
        "id": "O0",
        "name": "Bed",
        "position": [1.0, 1.0, 0.5],
    }
    assert [thing["id"] for thing in document["unassigned"]] == ["O5"]
    again = lines(run("rooms", tmp_path / "nested.json"))
    assert again == lines(run("rooms", scene))


def test_rooms_of_a_house_in_both_label_spaces_and_unfiltered(house: Path) -> None:
    assert lines(run("rooms", house)) == [
        {"room_id": "house1/0", "room": "bedroom", "objects": ["bed", "appliance"]}
    ]
    [room] = lines(run("rooms", house, "--labels", "nyuclass"))
    assert room["objects"] == ["bed", "refrigerator"]
    assert [room["room"] for room in lines(run("rooms", house, "--all"))] == ["bedroom", "yard"]


def test_frequencies_over_a_folder(house: Path) -> None:
    result = run("rooms", house.parent, "--frequencies", "--format", "csv")
    [row] = csv.DictReader(io.StringIO(result.stdout))
    assert (row["room"], row["occurrences"], float(row["percentage"])) == ("bedroom", "1", 100)
    table = run("rooms", house.parent, "--frequencies").stdout.splitlines()
    assert table[-1].split()[:2] == ["total", "1"]


def test_a_room_list_names_the_rooms_of_a_format_that_does_not(tmp_path: Path) -> None:
    scene = tmp_path / "s.semantic.txt"
    scene.write_text('HM3D Semantic Annotations\n1,AA,"bed",4\n2,AB,"oven",5\n')
    names = tmp_path / "names.csv"
    names.write_text("room_id,room\ns/4,bedroom\n5,kitchen;pantry\n")
    found = lines(run("rooms", scene, "--room-list", names))
    assert [room["room"] for room in found] == ["bedroom", "kitchen;pantry"]


def test_no_label_space_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "bare.json"
    path.write_text(json.dumps(graph([node("R0"), node("O0", 1)], [("R0", "O0")])))
    result = run("rooms", path)
    assert result.exit_code == 1
    assert result.stderr.startswith(f"error: {path}: no label space")
    assert "--labelspace FILE.yaml" in result.stderr
    assert result.stderr.count("\n") == 1


def test_label_names_rooms_and_says_how_many(scene: Path, tables: Path, tmp_path: Path) -> None:
    out = tmp_path / "labelled.json"
    result = run("label", scene, "-o", out, "--tables", tables, "--labels", "flat", "--offline")
    assert result.exit_code == 0, result.output
    assert "2 of 3 rooms named" in result.stderr
    assert "read as: stove = oven\n" in result.stderr
    rooms = [value["attributes"] for value in json.loads(out.read_text())["nodes"][:3]]
    assert [room["name"] for room in rooms] == ["bedroom", "kitchen", "R2"]
    assert [room["semantic_label"] for room in rooms[:2]] == [1, 4]  # 3 is the graph's own office
    assert sum(rooms[0]["semantic_class_probabilities"].values()) == pytest.approx(1)
    found = rooms[0]["metadata"]["roomtables"]
    assert found["rule"] == "query"
    assert found["model"] == "fit-scorer"
    assert found["label"] == "bedroom"
    assert {"version", "probability", "objects", "source", "answered_by"} <= found.keys()
    assert found["read_as"] == {"Bed": "bed"}
    assert rooms[1]["metadata"]["roomtables"]["read_as"] == {"stove": "oven"}
    assert rooms[1]["metadata"]["roomtables"]["unknown_objects"] == ["gizmo"]
    assert 'unknown to label space flat: "gizmo"\n' in result.stderr
    # What was labelled is not taken for the truth afterwards.
    assert all("room" not in room for room in lines(run("rooms", out)))


def test_label_takes_its_own_names_back_and_keeps_those_of_others(
    scene: Path, tables: Path, tmp_path: Path
) -> None:
    """The objects of R0 go, and a person names R1."""
    options = ("--tables", tables, "--labels", "flat", "--offline")
    labelled, again = tmp_path / "labelled.json", tmp_path / "again.json"
    assert run("label", scene, "-o", labelled, *options).exit_code == 0
    document = json.loads(labelled.read_text())
    document["edges"] = [edge for edge in document["edges"] if edge["source"] != node_id("R0")]
    document["nodes"][1]["attributes"]["name"] = "Mia's kitchen"
    labelled.write_text(json.dumps(document))
    for keep, second, count in (((), "kitchen", 1), (("--keep-names",), "Mia's kitchen", 0)):
        result = run("label", labelled, "-o", again, *options, *keep)
        assert f"{count} of 3 rooms named" in result.stderr
        rooms = [value["attributes"] for value in json.loads(again.read_text())["nodes"][:3]]
        assert [room["name"] for room in rooms] == ["R0", second, "R2"]
        assert "roomtables" not in rooms[0]["metadata"]


def test_label_leaves_the_original_alone_when_nothing_is_published(
    scene: Path, tmp_path: Path
) -> None:
    result = run("label", scene, "-o", scene, "--tables", tmp_path / "none", "--labels", "flat")
    assert result.exit_code == 1
    assert json.loads(scene.read_text())["nodes"][0]["attributes"]["name"] == "R0"


def test_label_refuses_formats_that_hold_no_names(house: Path, tables: Path) -> None:
    result = run("label", house, "-o", house.with_suffix(".out"), "--tables", tables)
    assert result.exit_code == 1
    assert "not a Spark-DSG graph" in result.stderr


@pytest.mark.parametrize("suffix", [".json", ".sparkdsg"])
@pytest.mark.parametrize("source", [".json", ".sparkdsg"])
def test_label_real_graphs_in_either_encoding(
    shared_data: Path, tables: Path, tmp_path: Path, source: str, suffix: str
) -> None:
    spark_dsg = pytest.importorskip("spark_dsg")
    scene, out = shared_data / "scene_graphs" / f"two_room_dsg{source}", tmp_path / f"out{suffix}"
    result = run("label", scene, "-o", out, "--tables", tables, "--labels", "flat", "--offline")
    assert result.exit_code == 0, result.output
    loaded = spark_dsg.DynamicSceneGraph.load(out)
    assert [node.attributes.name for node in loaded.get_layer("ROOMS").nodes] == [
        "bedroom",
        "kitchen",
    ]


@pytest.mark.parametrize(
    ("first_key", "padding"),
    [("SPARK_DSG_header", 0), ("robot", 0), ("SPARK_DSG_header", 100_000)],
    ids=["known", "unknown", "large"],
)
@pytest.mark.parametrize("command", ["classify", "label", "rooms", "show"])
def test_a_graph_is_decoded_once(
    scene: Path,
    tables: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    first_key: str,
    padding: int,
) -> None:
    """Also where its one line must be decoded to tell it from JSON lines."""
    document = {first_key: {}, **json.loads(scene.read_text()), "padding": "x" * padding}
    scene.write_text(json.dumps(document))
    decoded = []
    loads = json.loads

    def counting(*arguments: Any, **options: Any) -> Any:
        value = loads(*arguments, **options)
        decoded.append(isinstance(value, dict) and "nodes" in value)
        return value

    monkeypatch.setattr(json, "loads", counting)
    options = ("--tables", tables, "--labels", "flat", "--offline")
    arguments = {
        "classify": ("--input", scene, *options),
        "label": (scene, "-o", tmp_path / "out.json", *options),
        "rooms": (scene,),
        "show": (scene, "-o", tmp_path / "out.svg", *options),
    }
    if command == "show":
        pytest.importorskip("matplotlib")
    result = run(command, *arguments[command])
    assert result.exit_code == 0, result.output
    assert sum(decoded) == 1


def test_classify_takes_scenes(scene: Path, house: Path, tables: Path) -> None:
    options = ("--tables", tables, "--labels", "flat", "--offline", "--format", "jsonl")
    found = lines(run("classify", "--input", scene, *options))
    assert [room["room"] for room in found] == ["bedroom", "kitchen", None]
    assert found[1]["unknown_objects"] == ["gizmo"]
    told = run("classify", "--input", scene, *options).stderr.splitlines()
    assert told[-2:] == ["read as: stove = oven", 'unknown to label space flat: "gizmo"']
    assert [r["room"] for r in lines(run("classify", "--input", house, *options))] == ["bedroom"]


def test_show_draws_right_and_wrong(scene: Path, tables: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "scene.html"
    result = run("show", scene, "-o", out, "--tables", tables, "--labels", "flat", "--offline")
    assert result.exit_code == 0, result.output
    text = out.read_text()
    picture = text[text.index("<svg") : text.index("</svg>")]
    for shown in ("R1", "kitchen", "(true: office)", "Bed"):
        assert shown in picture
    assert "src=" not in text
    assert "href=" not in text.replace('xlink:href="#', "")
    assert '<tr style="color:#1b7f3b"><td>R0</td><td>bedroom</td>' in text
    assert '<tr style="color:#c0392b"><td>R1</td><td>kitchen</td>' in text


@pytest.mark.parametrize(("suffix", "begins"), [(".svg", b"<?xml"), (".png", b"\x89PNG")])
def test_show_without_tables_draws_the_truth(
    scene: Path, tmp_path: Path, suffix: str, begins: bytes
) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / f"scene{suffix}"
    result = run("show", scene, "-o", out, "--tables", tmp_path / "none")
    assert result.exit_code == 0, result.output
    assert "warning: drawn without answers" in result.stderr
    assert out.read_bytes().startswith(begins)


def test_show_refuses_other_pictures_and_scenes_without_places(
    scene: Path, tmp_path: Path, tables: Path
) -> None:
    assert run("show", scene, "-o", tmp_path / "s.pdf").exit_code == 1
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text('{"room_id": "1", "objects": ["bed"]}\n')
    result = run("show", rooms, "-o", tmp_path / "s.svg", "--tables", tables, "--labels", "flat")
    assert result.exit_code == 1
    assert "neither boxes nor positions" in result.stderr


def test_labels_import_makes_a_space_with_synonyms(tmp_path: Path) -> None:
    yaml = tmp_path / "space.yaml"
    yaml.write_text("label_names: [{label: 0, name: unknown}, {label: 1, name: couch}]\n")
    out = tmp_path / "mine"
    result = run("labels", "import", yaml, "-o", out)
    assert result.exit_code == 0, result.output
    [row] = csv.DictReader(io.StringIO((out / "objects.csv").read_text()))
    assert row["object"] == "couch"
    assert "sofa" in row["synonyms"].split("|")
    rooms = {row["room"] for row in csv.DictReader((out / "rooms.csv").open())}
    assert {"kitchen", "bathroom"} <= rooms
    assert run("labels", "import", yaml, "-o", out).exit_code == 1  # never overwritten
