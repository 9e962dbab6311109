"""Matterport3D ``.house`` files, with the clean-up of the paper's appendix.

An object whose centre lies outside its region's box moves to the smallest region whose box holds
it; both of its labels come from its own category line, so no label is ever one of several;
categories that say nothing about a room are left out, and so are outdoor, unnamed and empty rooms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from roomtables.errors import InputError, first_line
from roomtables.scenes.matterport_labels import ROOM_NAMES, UNNAMED, Category, object_namer
from roomtables.scenes.scene import (
    Box,
    Point,
    ReadOptions,
    Scene,
    SceneObject,
    SceneRoom,
    report_unassigned,
)
from roomtables.scenes.scene_file import SceneFile

_MAGIC = "ASCII 1."
_LONGEST_LINE = 65_536
_NOT_ROOMS = frozenset({"yard", "balcony", "porch", UNNAMED})


@dataclass(frozen=True, slots=True)
class Region:
    """An ``R`` line: its letter, and its box in metres."""

    index: int
    letter: str
    box: Box


@dataclass(frozen=True, slots=True)
class HouseObject:
    """An ``O`` line; ``region`` or ``category`` is −1 where the file gives none."""

    index: int
    region: int
    category: int
    position: Point
    box: Box | None


@dataclass(slots=True)
class House:
    """What a ``.house`` file says about regions, categories and objects."""

    name: str
    announced: dict[str, int] = field(default_factory=dict)
    regions: dict[int, Region] = field(default_factory=dict)
    categories: dict[int, Category] = field(default_factory=dict)
    objects: list[HouseObject] = field(default_factory=list)


def parse_house(lines: Iterable[str], source: str) -> House:
    """A house from its lines; only H, R, C and O lines are looked at.

    Raises
    ------
    InputError
        The first line is not ``ASCII 1.…``, a line is cut short or holds what is not a number, a
        box is NaN, or an object names a region or category that the file does not hold.
    """
    numbered = enumerate(lines, start=1)
    _, first = next(numbered, (1, ""))
    if not first.startswith(_MAGIC):
        raise InputError(f"{source}, line 1: a .house file begins with `ASCII 1.1`")
    house = House(Path(source).stem)
    places: list[str] = []
    for number, line in numbered:
        where = f"{source}, line {number}"
        if line[:1] in _LINES:
            try:
                _LINES[line[0]](house, line.split(), where)
            except (ValueError, IndexError) as error:
                why = first_line(error)
                raise InputError(f"{where}: malformed {line[0]} line ({why})") from error
            if line[0] == "O":
                places.append(where)
    _check_references(house, places)
    return house


def _header(house: House, cells: Sequence[str], where: str) -> None:
    if cells[1] != "-":
        house.name = cells[1]
    house.announced = dict(
        zip(("objects", "categories", "regions"), map(int, cells[8:11]), strict=False)
    )


def _region(house: House, cells: Sequence[str], where: str) -> None:
    if not cells[4].lstrip("-").isdigit():
        return  # mpview writes a portal with an R as well: its label stands here
    what = f"{where}: box of region {cells[1]}"
    box = Box(_finite_point(cells[9:12], what), _finite_point(cells[12:15], what))
    house.regions[int(cells[1])] = Region(int(cells[1]), cells[5], box)


def _category(house: House, cells: Sequence[str], where: str) -> None:
    names = cells[3].replace("#", " "), cells[5].replace("#", " ")
    house.categories[int(cells[1])] = Category(int(cells[2]), *names)


def _object(house: House, cells: Sequence[str], where: str) -> None:
    index, region, category = map(int, cells[1:4])
    position = _finite_point(cells[4:7], f"{where}: centre of object {index}")
    oriented = tuple(float(cell) for cell in cells[7:16])
    if len(oriented) < 9:
        raise ValueError("cut short")
    box = _oriented_box(position, oriented)
    house.objects.append(HouseObject(index, region, category, position, box))


_LINES: dict[str, Callable[[House, Sequence[str], str], None]] = {
    "H": _header,
    "R": _region,
    "C": _category,
    "O": _object,
}


def _finite_point(cells: Sequence[str], what: str) -> Point:
    if len(cells) < 3:
        raise ValueError("cut short")
    x, y, z = map(float, cells)
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"{what} is not finite; take the house from Matterport again")
    return (x, y, z)


def _oriented_box(centre: Point, numbers: tuple[float, ...]) -> Box | None:
    """The axis-aligned box around an oriented one: two axes, then three radii along all three."""
    if not all(math.isfinite(number) for number in numbers) or min(numbers[6:]) < 0:
        return None
    a, b, radii = numbers[:3], numbers[3:6], numbers[6:]
    c = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    axes = list(zip((a, b, c), radii, strict=True))
    reach = [sum(abs(axis[i]) * radius for axis, radius in axes) for i in range(3)]
    low, high = (
        (centre[0] + sign * reach[0], centre[1] + sign * reach[1], centre[2] + sign * reach[2])
        for sign in (-1, 1)
    )
    return Box(low, high)


def _check_references(house: House, places: Sequence[str]) -> None:
    for thing, where in zip(house.objects, places, strict=True):
        for kind, key, known in (
            ("region", thing.region, house.regions),
            ("category", thing.category, house.categories),
        ):
            if key >= 0 and key not in known:
                raise InputError(
                    f"{where}: object {thing.index} names {kind} {key}, which the file does not "
                    "hold; take the house from Matterport again"
                )


def region_of(thing: HouseObject, regions: Iterable[Region]) -> int | None:
    """The region that an object belongs to, by the paper's appendix; None where there is none.

    Its own where that box holds its centre, else the smallest region whose box does (the first of
    equals), else its own.
    """
    holding = [region for region in regions if region.box.contains(thing.position)]
    if any(region.index == thing.region for region in holding):
        return thing.region
    if holding:
        return min(holding, key=lambda region: (region.box.volume, region.index)).index
    return thing.region if thing.region >= 0 else None


def is_house(file: SceneFile) -> bool:
    """Whether a file begins as a ``.house`` file does."""
    return file.text.startswith(_MAGIC)


def read_house(file: SceneFile, options: ReadOptions) -> Scene:
    """One house; its rooms in the file's order, with the paper's filters unless ``keep_all``.

    Raises
    ------
    InputError
        The file is malformed (see `parse_house`), or `object_namer` refuses the options.
    """
    path = file.path
    with path.open(encoding="utf-8", errors="replace") as lines:
        house = parse_house(_short_lines(lines, path), str(path))
    _warn_if_short(house, path, options)
    namer = object_namer(options)
    contents: dict[int | None, list[SceneObject]] = {}
    for thing in house.objects:
        category = house.categories.get(thing.category)
        label = namer(category) if category else None
        if label is not None:
            found = SceneObject(f"O{thing.index}", label, thing.position, thing.box)
            contents.setdefault(region_of(thing, house.regions.values()), []).append(found)
    scene = Scene(
        house.name,
        list(_rooms(house, contents, options)),
        tuple(contents.get(None, ())),
    )
    report_unassigned(scene, sum(map(len, contents.values())), options.warn)
    return scene


def _short_lines(file: TextIO, path: Path) -> Iterator[str]:
    """The file's lines; one that never ends is refused instead of held."""
    while line := file.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise InputError(f"{path}: a line of over {_LONGEST_LINE} characters; no .house file")
        yield line


def _rooms(
    house: House, contents: dict[int | None, list[SceneObject]], options: ReadOptions
) -> Iterator[SceneRoom]:
    for region in house.regions.values():
        name = ROOM_NAMES.get(region.letter, UNNAMED)
        objects = tuple(contents.get(region.index, ()))
        if options.keep_all or (objects and name not in _NOT_ROOMS):
            yield SceneRoom(f"{house.name}/{region.index}", objects, name, (name,), region.box)


def _warn_if_short(house: House, path: Path, options: ReadOptions) -> None:
    for kind, found in (
        ("objects", house.objects),
        ("categories", house.categories),
        ("regions", house.regions),
    ):
        if len(found) < house.announced.get(kind, 0):
            announced = house.announced[kind]
            options.warn(f"{path}: {len(found)} of {announced} {kind}; is the file cut short?")
