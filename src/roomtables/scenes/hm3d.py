"""HM3D ``.semantic.txt``: objects with a category and the region that holds them.

After a header line, each line is ``id,HEXRGB,"category",region_id``; categories may hold commas,
region −1 is unknown, and regions have no names (a room list can give them).
"""

from __future__ import annotations

import csv
from pathlib import Path

from roomtables.errors import InputError
from roomtables.scenes.scene import ReadOptions, Scene, SceneObject, SceneRoom, report_unassigned

HEADER = "HM3D Semantic Annotations"


def read_hm3d(path: Path, options: ReadOptions) -> Scene:
    """One scene from an HM3D annotation file; rooms in order of region.

    Raises
    ------
    InputError
        A line has other than four cells, or its id or region is not an integer.
    """
    name = path.name.removesuffix(".txt").removesuffix(".semantic")
    regions: dict[int, list[SceneObject]] = {}
    total = 0
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(file, skipinitialspace=True)
        try:
            next(file, None)
            for row in rows:
                if row:
                    where = f"{path}, line {rows.line_num + 1}"
                    region, thing = _annotation(row, where)
                    regions.setdefault(region, []).append(thing)
                    total += 1
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"{path}, line {rows.line_num + 2}: unreadable ({error})") from error
    unknown = [thing for region in sorted(regions) if region < 0 for thing in regions.pop(region)]
    rooms = [SceneRoom(f"{name}/{region}", tuple(regions[region])) for region in sorted(regions)]
    scene = Scene(name, rooms, tuple(unknown))
    report_unassigned(scene, total, options.warn)
    return scene


def _annotation(row: list[str], where: str) -> tuple[int, SceneObject]:
    if len(row) < 4:
        raise InputError(f'{where}: expected id,colour,"category",region')
    category = ",".join(row[2:-1]).strip().strip('"')  # an unquoted category may hold commas
    try:
        return int(row[-1]), SceneObject(str(int(row[0])), category)
    except ValueError as error:
        wrong = f"`{row[0]}`, `{row[-1]}`"
        raise InputError(f"{where}: id and region must be integers, not {wrong}") from error
