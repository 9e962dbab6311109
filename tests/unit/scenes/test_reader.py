"""Formats told apart by content, the smaller formats, and files that are none of them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from roomtables.errors import InputError
from roomtables.rooms import Room
from roomtables.scenes import read_rooms, read_scene, read_scenes, reader
from roomtables.scenes.room_lists import write_nested
from roomtables.scenes.scene import ReadOptions, Scene, SceneRoom
from roomtables.scenes.scene_file import SceneFile
from scene_builders import box, graph, node

ROOMS = [Room("r1", ("bed", "lamp"), ("bedroom",)), Room("r2", ())]
LINES = "".join(json.dumps(room.as_json()) + "\n" for room in ROOMS)
NESTED = {
    "rooms": [
        {"id": "r1", "room": "bedroom", "objects": [{"id": "o1", "name": "bed"}, "lamp"]},
        {"id": "r2", "name": "R2", "objects": []},
    ]
}
CSV = "object,room_id,room\nbed,r1,bedroom\n,r2,\nlamp,r1,\n"


@pytest.mark.parametrize(
    "text",
    [
        LINES,
        "\ufeff" + LINES,
        "\n\n" + LINES.replace("\n", "\r\n"),
        json.dumps(NESTED),
        json.dumps(NESTED, indent=2),
        json.dumps({"scene": "flat", **NESTED}, indent=2),
        CSV,
        "\ufeff" + CSV,
    ],
)
@pytest.mark.parametrize("suffix", [".txt", ".jsonl", ".json", ".csv", ""])
def test_the_content_decides_the_format_whatever_the_name(
    tmp_path: Path, text: str, suffix: str
) -> None:
    path = tmp_path / f"rooms{suffix}"
    path.write_text(text, encoding="utf-8", newline="")
    assert list(read_rooms(path)) == ROOMS


def test_a_graph_is_told_from_a_binary_one_by_its_brace(tmp_path: Path) -> None:
    """Both begin with the same header; a byte-order mark does not hide the brace."""
    path = tmp_path / "graph.sparkdsg"
    document = graph([node("R0"), node("O0", 1)], [("R0", "O0")], {1: "bed"})
    path.write_text("\ufeff" + json.dumps(document), encoding="utf-8")
    assert list(read_rooms(path)) == [Room("R0", ("bed",))]


def test_a_new_format_is_one_more_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def is_listing(file: SceneFile) -> bool:
        return isinstance(file.document, dict) and "listing" in file.document

    def read_listing(file: SceneFile, options: ReadOptions) -> Scene:
        return Scene("listing", [SceneRoom(name, ()) for name in file.document["listing"]])

    row = reader.Format("a listing", is_listing, read_listing)
    monkeypatch.setattr(reader, "FORMATS", (row, *reader.FORMATS))
    path = tmp_path / "listing.json"
    for indent in (None, 2):
        path.write_text(json.dumps({"listing": ["r1", "r2"]}, indent=indent))
        assert list(read_rooms(path)) == [Room("r1", ()), Room("r2", ())]


def test_one_line_of_json_lines_is_a_room_list(tmp_path: Path) -> None:
    path = tmp_path / "one.json"
    path.write_text('{"objects": ["bed"], "room_id": 7, "room": ["bedroom", "den"]}')
    assert list(read_rooms(path)) == [Room("7", ("bed",), ("bedroom", "den"))]


def test_an_empty_file_holds_no_room(tmp_path: Path) -> None:
    path = tmp_path / "empty.jsonl"
    path.write_text("")
    assert list(read_rooms(path)) == []


def test_a_room_list_is_read_lazily(tmp_path: Path) -> None:
    path = tmp_path / "rooms.jsonl"
    path.write_text(LINES + "{broken\n")
    rooms = read_rooms(path)
    assert next(rooms) == ROOMS[0]
    assert next(rooms) == ROOMS[1]
    with pytest.raises(InputError, match="line 3: invalid JSON"):
        next(rooms)


def test_nested_json_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "rooms.jsonl"
    path.write_text(LINES)
    nested = tmp_path / "nested.json"
    nested.write_text("".join(write_nested(read_scenes(path))))
    document = json.loads(nested.read_text())
    assert document["rooms"][0] == {
        "id": "r1",
        "name": "bedroom",
        "room": "bedroom",
        "objects": [{"id": "r1/0", "name": "bed"}, {"id": "r1/1", "name": "lamp"}],
    }
    assert list(read_rooms(nested)) == ROOMS


def test_nested_json_without_rooms_is_whole(tmp_path: Path) -> None:
    assert json.loads("".join(write_nested([]))) == {"rooms": [], "unassigned": []}


def test_hm3d_categories_may_hold_commas_and_region_minus_one_is_no_room(tmp_path: Path) -> None:
    path = tmp_path / "scene1.semantic.txt"
    path.write_text(
        "HM3D Semantic Annotations\n"
        '1,0A1B2C,"bed",1\n2,0A1B2D,"rug, round",0\n3,0A1B2E,"lamp",-1\n4,FFFFFF,bed,1\n'
    )
    warnings: list[str] = []
    assert list(read_rooms(path, warn=warnings.append)) == [
        Room("scene1/0", ("rug, round",)),
        Room("scene1/1", ("bed", "bed")),
    ]
    assert warnings == ["scene1: 1 of 4 objects lies in no room: 3 (lamp)"]


@pytest.mark.parametrize("line", ['1,AA,"bed"', '1,AA,"bed",kitchen', 'x,AA,"bed",1'])
def test_malformed_hm3d_lines_are_refused(tmp_path: Path, line: str) -> None:
    path = tmp_path / "scene1.semantic.txt"
    path.write_text(f'HM3D Semantic Annotations\n1,AA,"bed",1\n{line}\n')
    with pytest.raises(InputError, match="line 3: "):
        list(read_rooms(path))


def hovsg(folder: Path) -> Path:
    for kind, values in {
        "rooms": [
            {"room_id": "0_1", "name": "bedroom", "floor_id": "0", "objects": ["0_1_0", "0_1_1"]},
            {"room_id": "0_2", "name": None, "floor_id": "0", "objects": ["0_2_9"]},
        ],
        "objects": [
            {"object_id": "0_1_0", "room_id": "0_1", "name": "bed"},
            {"object_id": "0_1_1", "room_id": "0_1", "name": "lamp"},
            {"object_id": "0_3_0", "room_id": "0_3", "name": "sofa"},
        ],
    }.items():
        (folder / kind).mkdir(parents=True)
        for value in values:
            key = value.get("object_id", value["room_id"])
            (folder / kind / f"{key}.json").write_text(json.dumps(value))
    return folder


def test_hovsg_folders_give_rooms_whose_names_are_no_truth(tmp_path: Path) -> None:
    warnings: list[str] = []
    hovsg(tmp_path / "graph")
    scene = read_scene(tmp_path, ReadOptions(warn=warnings.append))
    rooms = list(scene.rooms)
    assert [room.as_room() for room in rooms] == [Room("0_1", ("bed", "lamp")), Room("0_2", ())]
    assert rooms[0].name == "bedroom"
    assert [thing.name for thing in scene.unassigned] == ["sofa"]
    assert "no objects/0_2_9.json" in warnings[0]


def test_malformed_hovsg_files_are_refused(tmp_path: Path) -> None:
    folder = hovsg(tmp_path)
    (folder / "rooms" / "0_1.json").write_text('{"room_id": "0_1"')
    with pytest.raises(InputError, match=r"0_1\.json: invalid JSON"):
        list(read_rooms(folder))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("room_id,name\n1,bed\n", "line 1|missing column `object`"),
        ("room_id,object\n1,bed,3\n", "line 2: expected 2 fields"),
        ("room_id,object\n,bed\n", "line 2: empty `room_id`"),
        ("room_id,object,room\n1,bed,den\n1,sofa,bar\n", "line 3: room 1 is `bar` here"),
        ('{"room_id": "1", "objects": "bed"}\n', "line 1: `objects` must be a list"),
        ('{"rooms": 3}', "`rooms` must be a list"),
        ('{"rooms": [{"id": "1"}]}', r"rooms\[0\]: `objects` must be a list"),
        ('{"rooms": [{"id": "1", "objects": [{"id": 2}]}]}', r"objects\[0\]: expected an object"),
        ('{"rooms": [', "invalid JSON .* cut short"),
        ("[1, 2]", "no scene that roomtables knows"),
        ("hello world\n", "not a format that roomtables reads"),
        ("\0\1\2\3", "not a format that roomtables reads"),
    ],
)
def test_malformed_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "rooms.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        list(read_rooms(path))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "head", [b"", b"PK\3\4", b"{", b'{"type": "mesh", ', b'{"nodes": [', b"ASCII 1.1\n"]
)
def test_a_huge_file_of_the_wrong_kind_is_refused_unread(tmp_path: Path, head: bytes) -> None:
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        file.write(head)
        file.truncate(1 << 41)  # sparse: two terabytes that no reader could hold
    with pytest.raises(InputError):
        list(read_rooms(path))


JUNK = [None, True, -1, 10**400, float("inf"), float("nan"), "", "x", [], {}, [1], {"a": [2]}]


def _damaged(document: Any) -> Iterator[Any]:
    """The document with one value replaced by junk; the same object each time, then mended."""

    def within(holder: Any) -> Iterator[Any]:
        for key, sound in list(holder.items() if isinstance(holder, dict) else enumerate(holder)):
            for junk in JUNK:
                holder[key] = junk
                yield document
            holder[key] = sound
            if isinstance(sound, dict | list):
                yield from within(sound)

    return within(document)


@pytest.mark.parametrize(
    "document",
    [
        graph(
            [
                node("R0", 1, bounding_box=box((0, 0, 0), (1, 1, 1))),
                node("p0"),
                node("p1"),
                node("O0", 1, bounding_box=box((0, 0, 0), (1, 1, 1))),
            ],
            [("R0", "p0"), ("O0", "p0"), ("R0", "p1"), ("O0", "p1")],
            {1: "bed"},
            {1: "bedroom"},
        ),
        {**NESTED, "unassigned": [{"id": 1, "name": "bed", "position": [1, 2, 3]}]},
        ROOMS[0].as_json(),
    ],
    ids=["graph", "nested", "line"],
)
def test_whatever_stands_in_a_document_is_read_or_refused(
    tmp_path: Path, document: dict[str, Any]
) -> None:
    """Every value of a sound document, replaced by each kind of junk."""
    path = tmp_path / "junk.json"
    outcomes = Counter[str]()
    # Written over in place, blanks at the end: to open or cut a file costs more than all the rest.
    length = len(json.dumps(document)) + 500
    with path.open("w") as file:
        for damaged in _damaged(document):
            file.seek(0)
            file.write(json.dumps(damaged).ljust(length))
            file.flush()
            try:
                json.dumps([room.as_json() for room in read_rooms(path)])
                outcomes["read"] += 1
            except InputError as error:
                outcomes["refused"] += 1
                outcomes["unplaced"] += str(path) not in str(error)
    assert min(outcomes["read"], outcomes["refused"]) > 0
    assert outcomes["unplaced"] == 0


def test_deep_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    path.write_text('{"nodes": ' + "[" * 200_000)
    with pytest.raises(InputError):
        list(read_rooms(path))


@pytest.mark.parametrize("name", ["missing", "."])
def test_a_path_without_scene_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        list(read_rooms(tmp_path / name))
