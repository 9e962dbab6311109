"""Formats that roomtables does not read are refused by their own names; its own never are."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from roomtables.errors import InputError
from roomtables.scenes.reader import read_graph, read_rooms
from scene_builders import graph, node

PROCTHOR = {
    "doors": [{"assetId": "Doorway_1", "holePolygon": [], "room0": "room|2", "room1": "room|3"}],
    "metadata": {"schema": "1.0.0"},
    "objects": [{"assetId": "Bed_1", "id": "Bed|2|0", "position": {"x": 1, "y": 0, "z": 2}}],
    "proceduralParameters": {"ceilingMaterial": "PureWhite"},
    "rooms": [
        {"children": [], "floorPolygon": [], "id": "room|2", "roomType": "Bedroom"},
        {"children": [], "floorPolygon": [], "id": "room|3", "roomType": "Kitchen"},
    ],
    "walls": [{"id": "wall|2|0", "polygon": []}],
    "windows": [],
}
SSG_OBJECTS = {"scans": [{"scan": "0cac7578", "objects": [{"id": "1", "label": "floor"}]}]}
SSG_RELATIONS = {
    "scans": [{"scan": "0cac7578", "relationships": [[1, 2, 3, "on"]], "objects": {"1": "floor"}}]
}
SCANNET = {
    "sceneId": "scannet.scene0000_00",
    "appId": "Aggregator.v2",
    "segGroups": [{"id": 0, "objectId": 0, "segments": [1, 2], "label": "window"}],
    "segmentsFile": "scannet.scene0000_00_vh_clean_2.0.010000.segs.json",
}
REPLICA_CAD = {
    "stage_instance": {"template_name": "stages/frl_apartment_stage"},
    "default_lighting": "lighting/frl_apartment_stage",
    "object_instances": [{"template_name": "frl_apartment_bed", "translation": [0, 0, 0]}],
    "articulated_object_instances": [],
}
CONCEPT_GRAPHS = {
    "object_1": {
        "id": 1,
        "object_tag": "lamp",
        "object_caption": "",
        "bbox_extent": [1, 1, 1],
        "bbox_center": [0, 0, 0],
        "bbox_volume": 1.0,
    }
}
RELATIONS = [{"object1": {"id": 1}, "object2": {"id": 2}, "object_relation": "a on b"}]
FOREIGN = {
    "ProcTHOR": PROCTHOR,
    "3DSSG": SSG_OBJECTS,
    "3DSSG's": SSG_RELATIONS,
    "ScanNet": SCANNET,
    "ReplicaCAD": REPLICA_CAD,
    "ConceptGraphs": CONCEPT_GRAPHS,
    "map of ConceptGraphs": list(CONCEPT_GRAPHS.values()),
    "relations": RELATIONS,
}


def refused(path: Path, name: str) -> None:
    for read in (lambda: list(read_rooms(path)), lambda: read_graph(path)):
        with pytest.raises(InputError) as caught:
            read()
        message = str(caught.value)
        assert message.startswith(f"{path}: this is ")
        assert name in message
        assert "which roomtables does not read; write its rooms as lines" in message


@pytest.mark.parametrize("indent", [None, 2])
@pytest.mark.parametrize("name", FOREIGN)
def test_a_foreign_format_is_refused_by_its_name(tmp_path: Path, name: str, indent: Any) -> None:
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(FOREIGN[name], indent=indent))
    refused(path, name)


def test_houses_a_line_each_are_refused_too(tmp_path: Path) -> None:
    path = tmp_path / "train.jsonl"
    house = PROCTHOR | {"objects": PROCTHOR["objects"] * 2000}  # longer than what is looked at
    path.write_text(f"{json.dumps(PROCTHOR)}\n{json.dumps(house)}\n")
    refused(path, "a ProcTHOR house")


def test_a_pickled_map_is_refused_without_being_loaded(tmp_path: Path) -> None:
    path = tmp_path / "full_pcd_ram_update.pkl.gz"
    path.write_bytes(gzip.compress(b"cos\nsystem\n(S'false'\ntR."))
    refused(path, "a pickled map of ConceptGraphs")


@pytest.mark.parametrize(
    "document",
    [
        {"rooms": [{"id": "1", "objects": ["bed"], "floorPolygon": []}], "walls": [], "scans": []},
        {"rooms": [{"id": "1", "objects": [{"id": "a", "name": "bed"}]}], "segGroups": []},
        {"room_id": "1", "objects": ["bed"], "scans": [{"scan": "1"}], "segGroups": []},
        graph([node("R0"), node("O0", 1)], [("R0", "O0")], {1: "bed"}) | {"segGroups": []},
    ],
)
@pytest.mark.parametrize("times", [1, 2])
def test_what_roomtables_reads_is_read_whatever_else_it_holds(
    tmp_path: Path, document: dict[str, Any], times: int
) -> None:
    if times > 1 and "room_id" not in document:
        pytest.skip("a document stands alone")
    path = tmp_path / "scene.json"
    path.write_text(f"{json.dumps(document)}\n" * times)
    assert [room.objects for room in read_rooms(path)] == [("bed",)] * times
