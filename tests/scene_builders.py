"""Small scenes for tests: Spark-DSG documents of two generations and Matterport houses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

UNSET = 2**32 - 1
LAYERS = {"O": 2, "a": 2, "p": 3, "R": 4, "B": 5}
TYPES = {
    "O": "ObjectNodeAttributes",
    "a": "AgentNodeAttributes",
    "p": "PlaceNodeAttributes",
    "R": "RoomNodeAttributes",
    "B": "SemanticNodeAttributes",
}


def node_id(symbol: str) -> int:
    """``R3`` as Spark-DSG numbers it."""
    return ord(symbol[0]) << 56 | int(symbol[1:])


def node(symbol: str, label: int = UNSET, **attributes: Any) -> dict[str, Any]:
    """A node as Spark-DSG 1.1 writes it, with the attributes that matter here."""
    values = {
        "type": TYPES[symbol[0]],
        "name": symbol,
        "position": [0.0, 0.0, 0.0],
        "semantic_label": label,
        "metadata": {},
        **attributes,
    }
    layer = LAYERS[symbol[0]]
    return {"id": node_id(symbol), "layer": layer, "partition": 0, "attributes": values}


def graph(
    nodes: Iterable[dict[str, Any]],
    edges: Iterable[tuple[str, str]],
    labels: Mapping[int, str] | None = None,
    rooms: Mapping[int, str] | None = None,
) -> dict[str, Any]:
    """A graph document; ``labels`` and ``rooms`` are label spaces written into it."""
    spaces = {}
    if labels is not None:
        spaces["_l2p0"] = [[key, name] for key, name in labels.items()]
    if rooms is not None:
        spaces["_l4p0"] = [[key, name] for key, name in rooms.items()]
    return {
        "SPARK_DSG_header": {
            "project_name": "main",
            "version": {"major": 1, "minor": 1, "patch": 3},
        },
        "directed": False,
        "edges": [
            {"source": node_id(a), "target": node_id(b), "info": {"type": "EdgeAttributes"}}
            for a, b in edges
        ],
        "metadata": {"labelspaces": spaces} if spaces else {},
        "multigraph": False,
        "nodes": list(nodes),
    }


def box(low: Sequence[float], high: Sequence[float]) -> dict[str, Any]:
    """A bounding box as Spark-DSG 1.1 writes it."""
    return {
        "type": "AABB",
        "dimensions": [b - a for a, b in zip(low, high, strict=True)],
        "world_P_center": [(a + b) / 2 for a, b in zip(low, high, strict=True)],
        "world_R_center": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
    }


class House:
    """A Matterport ``.house`` file, line by line, as its documentation lays the fields out."""

    def __init__(self, name: str = "house1") -> None:
        self.name = name
        self.regions: list[str] = []
        self.categories: list[str] = []
        self.objects: list[str] = []

    def region(self, letter: str, low: Sequence[float], high: Sequence[float]) -> int:
        index = len(self.regions)
        numbers = _numbers([*low, *low, *high, high[2] - low[2]])
        self.regions.append(f"R  {index} 0  0 0  {letter}  {numbers}  0 0 0 0 ")
        return index

    def category(self, name: str, mpcat40: str, mapping_index: int = 0) -> int:
        index = len(self.categories)
        names = name.replace(" ", "#"), mpcat40.replace(" ", "#")
        self.categories.append(f"C  {index}  {mapping_index} {names[0]}  0 {names[1]}  0 0 0 0 0 ")
        return index

    def object(self, region: int, category: int, centre: Sequence[float]) -> int:
        index = len(self.objects)
        oriented = "1 0 0  0 1 0  0.5 0.25 0.125"
        self.objects.append(
            f"O  {index} {region} {category}  {_numbers(centre)}  {oriented}  0 0 0 0 0 0 0 0 "
        )
        return index

    def text(self) -> str:
        counts = f"{len(self.objects)} {len(self.categories)} {len(self.regions)}"
        lines = [
            "ASCII 1.1",
            f"H  {self.name}  -  0 1 0 0 1 {counts} 1  1  0 0 0 0 0  0 0 0  9 9 9  0 0 0 0 0 ",
            "L  0  0  -  0 0 0  0 0 0  9 9 9  0 0 0 0 0 ",
            *self.regions,
            "R  0 0  1  -  0 0 0  1 1 1  0 0 0 0 ",  # a portal, as mpview writes it
            "P  0 0 1  -  0 0 0  1 1 1  0 0 0 0 ",  # a portal, as documented
            "S  0 0  0  -  0 0 0  0 0 1  0 0 0  1 1 1  0 0 0 0 0 ",
            "V  0 0  -  0 0 0  0 0 1  0 0 0 ",
            "P  0a1b2c  0 0  0  1 1 1  0 0 0 0 0 ",  # a panorama
            *self.categories,
            *self.objects,
            "E  0 0 0  0.5  0 0 0  0 0 0  1 1 1  0 0 0 0 0 ",
        ]
        return "\n".join(lines) + "\n"

    def write(self, folder: Path) -> Path:
        path = folder / f"{self.name}.house"
        path.write_text(self.text(), encoding="utf-8")
        return path


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:g}" for value in values)
