"""HM3D ``.semantic.txt``: objects with a category and the region that holds them.

After a header line, each line is ``id,HEXRGB,"category",region_id``; categories may hold commas,
region −1 is unknown, and regions have no names (a room list can give them).
"""

from __future__ import annotations

from pathlib import Path

from roomtables.csv_rows import csv_lines
from roomtables.errors import InputError
from roomtables.scenes.scene import ReadOptions, Scene, SceneObject, SceneRoom, report_unassigned
from roomtables.scenes.scene_file import SceneFile

_HEADER = "HM3D Semantic Annotations"


def is_hm3d(file: SceneFile) -> bool:
    """Whether a file has the header line of HM3D's annotations."""
    return file.first_line == _HEADER


def read_hm3d(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from an HM3D annotation file; rooms in order of region.

    Raises
    ------
    InputError
        A line has other than four cells, or its id or region is not an integer.
    """
    regions = _regions(file.path)
    total = sum(map(len, regions.values()))
    unknown = [thing for region in sorted(regions) if region < 0 for thing in regions.pop(region)]
    name = file.path.name.removesuffix(".txt").removesuffix(".semantic")
    rooms = [SceneRoom(f"{name}/{region}", tuple(regions[region])) for region in sorted(regions)]
    scene = Scene(name, rooms, tuple(unknown))
    report_unassigned(scene, total, options.warn)
    return scene


def _regions(path: Path) -> dict[int, list[SceneObject]]:
    """The objects of each region."""
    regions: dict[int, list[SceneObject]] = {}
    rows = csv_lines(path, skipinitialspace=True)
    next(rows, None)  # the header
    for where, row in rows:
        if row:
            region, thing = _annotation(row, where)
            regions.setdefault(region, []).append(thing)
    return regions


def _annotation(row: list[str], where: str) -> tuple[int, SceneObject]:
    """A line's region and object."""
    if len(row) < 4:
        raise InputError(f'{where}: expected id,colour,"category",region')
    category = ",".join(row[2:-1]).strip().strip('"')  # an unquoted category may hold commas
    try:
        return int(row[-1]), SceneObject(str(int(row[0])), category)
    except ValueError as error:
        wrong = f"`{row[0][:40]}`, `{row[-1][:40]}`"
        raise InputError(f"{where}: id and region must be integers, not {wrong}") from error
