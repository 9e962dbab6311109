"""Matterport houses, written to the documented grammar: every rule of the paper's appendix."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import pytest

from roomtables.errors import InputError
from roomtables.scenes import read_rooms, read_scene
from roomtables.scenes.matterport import HouseObject, Region, region_of
from roomtables.scenes.scene import Box, ReadOptions, room_frequencies
from scene_builders import House

PAPER_ROOMS = """
    bar, bathroom, bedroom, classroom, closet, conference room, dining room, family room, game room,
    garage, gym, hallway, kitchen, laundry room, library, living room, lobby, lounge, office, spa,
    staircase, television room, utility room
"""


def rooms(path: Path, **options: object) -> dict[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    found = read_rooms(path, **options)  # type: ignore[arg-type]
    return {room.room_id: (room.truth, room.objects) for room in found}


def one_room(folder: Path, category: str, mpcat40: str, **options: object) -> list[str]:
    """The objects of a bedroom that holds a bed and one object of the category given."""
    house = House()
    bedroom = house.region("b", (0, 0, 0), (4, 4, 3))
    house.object(bedroom, house.category("bed", "bed"), (1, 1, 1))
    house.object(bedroom, house.category(category, mpcat40), (2, 1, 1))
    found = rooms(house.write(folder), **options)
    return list(found["house1/0"][1])[1:]


def test_an_object_outside_its_region_moves_to_the_smallest_box_that_holds_it(
    tmp_path: Path,
) -> None:
    house = House()
    living = house.region("l", (0, 0, 0), (10, 10, 3))
    bath = house.region("a", (20, 0, 0), (23, 3, 3))
    house.region("h", (18, 0, 0), (40, 10, 3))
    sofa, toilet = house.category("sofa", "sofa"), house.category("toilet", "toilet")
    house.object(living, sofa, (5, 5, 1))
    house.object(living, toilet, (21, 1, 1))  # inside bathroom and hallway: bathroom is smaller
    house.object(living, toilet, (50, 50, 1))  # inside no box: stays
    house.object(bath, sofa, (30, 5, 1))  # only the hallway holds it
    found = rooms(house.write(tmp_path))
    assert found == {
        "house1/0": (("living room",), ("sofa", "toilet")),
        "house1/1": (("bathroom",), ("toilet",)),
        "house1/2": (("hallway",), ("sofa",)),
    }


def test_an_object_stays_in_its_own_region_though_a_smaller_box_holds_it_too(
    tmp_path: Path,
) -> None:
    house = House()
    living = house.region("l", (0, 0, 0), (10, 10, 3))
    house.region("c", (1, 1, 0), (2, 2, 3))
    house.object(living, house.category("lamp", "lighting"), (1.5, 1.5, 1))
    assert list(rooms(house.write(tmp_path))) == ["house1/0"]


def test_equal_boxes_give_the_object_to_the_region_that_comes_first() -> None:
    one = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    thing = HouseObject(0, 9, 0, (1.0, 1.0, 1.0), None)  # on the wall: inside
    assert region_of(thing, [Region(4, "b", one), Region(2, "b", one)]) == 2


def test_an_object_without_region_finds_one_by_its_centre_or_is_reported(tmp_path: Path) -> None:
    house = House()
    house.region("k", (0, 0, 0), (4, 4, 3))
    stove, sink = house.category("stove", "appliances"), house.category("sink", "sink")
    house.object(-1, stove, (1, 1, 1))
    house.object(-1, sink, (9, 9, 9))
    warnings: list[str] = []
    scene = read_scene(house.write(tmp_path), ReadOptions(warn=warnings.append))
    assert [room.as_room().objects for room in scene.rooms] == [("appliance",)]
    assert [thing.name for thing in scene.unassigned] == ["sink"]
    assert warnings == ["house1: 1 of 2 objects lies in no room: O1 (sink)"]


def test_an_object_without_category_is_left_out(tmp_path: Path) -> None:
    house = House()
    bedroom = house.region("b", (0, 0, 0), (4, 4, 3))
    house.object(bedroom, -1, (1, 1, 1))
    house.object(bedroom, house.category("bed", "bed"), (1, 1, 1))
    assert rooms(house.write(tmp_path)) == {"house1/0": (("bedroom",), ("bed",))}


@pytest.mark.parametrize(
    "mpcat40", ["void", "wall", "floor", "ceiling", "objects", "misc", "unlabeled"]
)
def test_mpcat40_leaves_out_the_categories_that_say_nothing(tmp_path: Path, mpcat40: str) -> None:
    assert one_room(tmp_path, "bottle", mpcat40) == []


def test_mpcat40_names_are_the_authors(tmp_path: Path) -> None:
    matterport = ["tv_monitor", "appliances", "blinds", "board_panel", "chest_of_drawers", "stairs"]
    authors = ["tv", "appliance", "blind", "board panel", "chest of drawers", "stairs"]
    assert [one_room(tmp_path, "thing", name)[0] for name in matterport] == authors


@pytest.mark.parametrize(
    ("category", "mpcat40", "expected"),
    [
        ("refridgerator", "appliances", ["refrigerator"]),
        ("excercise equipment", "gym_equipment", ["exercise equipment"]),
        ("bottle", "objects", ["bottle"]),  # `objects` stays in nyuClass
        ("stairs", "misc", ["stairs"]),  # another row of the class is not rejected
        ("armchair", "chair", ["chair"]),  # no class of its own: its mpcat40 name is one
        ("side table", "table", ["table"]),
        ("wall", "wall", []),
        ("ceiling", "ceiling", []),
        ("floor", "floor", []),
        ("floor", "window", []),  # rejected by its name, whatever its mpcat40
        ("wall behind door", "wall", []),
        ("unknown", "unlabeled", []),
    ],
)
def test_nyuclass_without_the_mapping_goes_by_the_category_name(
    tmp_path: Path, category: str, mpcat40: str, expected: list[str]
) -> None:
    assert one_room(tmp_path, category, mpcat40, object_labels="nyuclass") == expected


def test_nyuclass_with_the_mapping_goes_by_its_row(tmp_path: Path) -> None:
    mapping = tmp_path / "category_mapping.tsv"
    mapping.write_text(
        "index\traw_category\tnyuClass\tmpcat40\n7\tfridge door\trefridgerator\tappliances\n"
        "8\tdecor\t\tobjects\n9\tpartition\twall\twall\n"
    )
    house = House()
    kitchen = house.region("k", (0, 0, 0), (4, 4, 3))
    for index in (7, 8, 9):
        house.object(kitchen, house.category("any", "objects", index), (1, 1, 1))
    path = house.write(tmp_path)
    found = rooms(path, object_labels="nyuclass", category_mapping=mapping)
    assert found == {"house1/0": (("kitchen",), ("refrigerator",))}


def test_a_file_that_is_no_mapping_is_refused(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.tsv"
    mapping.write_text("a\tb\n1\t2\n")
    with pytest.raises(InputError, match="not Matterport's category_mapping"):
        one_room(tmp_path, "bed", "bed", object_labels="nyuclass", category_mapping=mapping)


def test_only_matterports_own_label_spaces_can_be_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="mpcat40 and nyuclass, not 'ade20k'"):
        one_room(tmp_path, "bed", "bed", object_labels="ade20k")


def all_letters() -> House:
    house = House()
    bed = house.category("bed", "bed")
    for index, letter in enumerate("abcdefghijklmnopqrstuvwxyzBCDSZ-"):
        region = house.region(letter, (10 * index, 0, 0), (10 * index + 9, 9, 3))
        house.object(region, bed, (10 * index + 1, 1, 1))
    house.region("b", (0, 100, 0), (9, 109, 3))  # a bedroom that holds nothing
    return house


def test_room_letters_read_as_the_papers_23_labels(tmp_path: Path) -> None:
    found = read_rooms(all_letters().write(tmp_path))
    count = Counter(room.truth[0] for room in found)
    expected = {name.strip() for name in PAPER_ROOMS.split(",")}
    assert len(expected) == 23
    assert count == Counter(dict.fromkeys(expected, 1) | {"bathroom": 2, "dining room": 2})


def test_outdoor_unnamed_and_empty_rooms_are_dropped_unless_all_are_kept(tmp_path: Path) -> None:
    path = all_letters().write(tmp_path)
    assert len(list(read_rooms(path))) == 25
    kept = list(read_rooms(path, keep_all=True))
    assert len(kept) == 33
    names = Counter(room.truth[0] for room in kept)
    assert [names[name] for name in ("none", "yard", "balcony", "porch")] == [4, 1, 1, 1]
    assert kept[-1].objects == ()


def test_frequencies_count_true_labels(tmp_path: Path) -> None:
    scene = read_scene(all_letters().write(tmp_path))
    assert room_frequencies(scene.rooms)["bathroom"] == 2


def test_boxes_follow_the_oriented_box(tmp_path: Path) -> None:
    house = House()
    bedroom = house.region("b", (0, 0, 0), (4, 4, 3))
    house.object(bedroom, house.category("bed", "bed"), (1, 1, 1))
    [room] = read_scene(house.write(tmp_path)).rooms
    assert room.box == Box((0.0, 0.0, 0.0), (4.0, 4.0, 3.0))
    assert room.objects[0].box == Box((0.5, 0.75, 0.875), (1.5, 1.25, 1.125))


def test_a_folder_of_houses_is_read_house_by_house(tmp_path: Path) -> None:
    for name in ("b", "a"):
        house = House(name)
        region = house.region("b", (0, 0, 0), (4, 4, 3))
        house.object(region, house.category("bed", "bed"), (1, 1, 1))
        (tmp_path / name).mkdir()
        house.write(tmp_path / name)
    assert [room.room_id for room in read_rooms(tmp_path)] == ["a/0", "b/0"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("ASCII 1.1", "ASCII 1.1\nC  0  0 bed"), "line 2: malformed C line"),
        (("O  0 0 0  1 1 1", "O  0 0 0  1 nan 1"), "centre of object 0 is not finite"),
        (("O  0 0 0", "O  0 7 0"), "object 0 names region 7, which the file does not hold"),
        (("O  0 0 0", "O  0 0 5"), "object 0 names category 5"),
        (("b  0 0 0  0", "b  0 0 0  x"), "malformed R line"),
        (("0 0 0 4 4 3 3", "0 0 nan 4 4 3 3"), "box of region 0 is not finite"),
    ],
)
def test_malformed_houses_are_refused_with_file_and_line(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    house = House()
    bedroom = house.region("b", (0, 0, 0), (4, 4, 3))
    house.object(bedroom, house.category("bed", "bed"), (1, 1, 1))
    text = house.text().replace("b  0 0 0 0 0 0 4 4 3 3", "b  0 0 0  0 0 0 4 4 3 3")
    assert change[0] in text
    path = tmp_path / "bad.house"
    path.write_text(text.replace(*change))
    with pytest.raises(InputError, match=message) as caught:
        list(read_rooms(path))
    assert str(caught.value).startswith(f"{path}, line ")


def test_a_file_that_holds_less_than_it_announces_is_reported(tmp_path: Path) -> None:
    path = all_letters().write(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:-3]) + "\n")
    warnings: list[str] = []
    list(read_rooms(path, warn=warnings.append))
    assert warnings == [f"{path}: 30 of 32 objects; is the file cut short?"]


def test_category_names_mostly_say_what_matterports_mapping_says(shared_data: Path) -> None:
    """The figure in the warning: instances whose nyuClass the category's name alone gives."""
    from roomtables.scenes.matterport_labels import Category, object_namer

    mapping = shared_data / "matterport3d" / "category_mapping.tsv"
    by_name = object_namer(ReadOptions(object_labels="nyuclass"))
    by_row = object_namer(ReadOptions(object_labels="nyuclass", category_mapping=mapping))
    agree = total = 0
    with mapping.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file, delimiter="\t"):
            line = Category(int(row["index"]), row["raw_category"], row["mpcat40"])
            total += int(row["count"])
            agree += int(row["count"]) * (by_name(line) == by_row(line))
    assert 0.9 < agree / total < 0.97
