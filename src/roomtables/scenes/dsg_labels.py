"""Rooms named inside a Spark-DSG graph's JSON; nothing else in the graph changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from roomtables.scenes.dsg_graph import Graph
from roomtables.scenes.dsg_values import symbol

UNKNOWN_LABEL = 0


@dataclass(frozen=True, slots=True)
class NamedRoom:
    """A room's answer: its label, each candidate's probability, and where the answer came from."""

    label: str
    probabilities: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)


def room_label_ids(known: Mapping[int, str], labels: Iterable[str]) -> dict[str, int]:
    """An id for each room label: the graph's own where it has one, else the next one free.

    Ids start at 1; 0 stays unknown, as Hydra writes it for rooms that have no label.
    """
    ids: dict[str, int] = {}
    for number, name in known.items():
        for part in name.split(";"):
            ids.setdefault(part.strip(), number)
    free = max(known, default=UNKNOWN_LABEL) + 1
    for label in labels:
        if label not in ids:
            ids[label], free = free, free + 1
    return ids


def label_rooms(
    document: dict[str, Any], graph: Graph, named: Mapping[str, NamedRoom], labels: Iterable[str]
) -> None:
    """Write names into the graph's JSON, in place; rooms without an answer keep what they have.

    ``named`` goes by the rooms' symbols (``R0``), and ``labels`` are all the rooms that could have
    been the answer: they become the graph's room label space where it has none; where it has one,
    only the labels that it lacks and that are used are added to it.
    """
    space = f"_l{graph.room_layer}p0"
    known = graph.label_spaces.get(space, {})
    used = sorted({room.label for room in named.values()})
    ids = room_label_ids(known, used if known else sorted({*labels, *used}))
    if named:
        spaces = _child(_child(document, "metadata"), "labelspaces")
        added = [[number, label] for label, number in ids.items() if number not in known]
        old = spaces.get(space) if known else [[UNKNOWN_LABEL, "unknown"]]
        spaces[space] = [*_pairs(old), *added]
    for key in graph.rooms:
        room = named.get(symbol(key))
        if room is not None:
            attributes = graph.attributes(key)
            attributes["name"] = room.label
            attributes["semantic_label"] = ids[room.label]
            attributes["semantic_class_probabilities"] = dict(room.probabilities)
            _child(attributes, "metadata")["roomtables"] = dict(room.provenance)


def _pairs(space: Any) -> list[Any]:
    if isinstance(space, dict):
        return [[int(label), name] for label, name in space.items()]
    return list(space)


def _child(value: dict[str, Any], key: str) -> dict[str, Any]:
    """The dictionary under a key, made where there is none."""
    if not isinstance(value.get(key), dict):
        value[key] = {}
    child: dict[str, Any] = value[key]
    return child
