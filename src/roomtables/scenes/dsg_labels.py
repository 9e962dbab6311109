"""Rooms named inside a Spark-DSG graph's JSON; nothing else in the graph changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from roomtables.scenes.dsg_graph import Graph, symbol

UNKNOWN_LABEL = 0


@dataclass(frozen=True, slots=True)
class NamedRoom:
    """A room's answer: its label, each candidate's probability, and where the answer came from."""

    label: str
    probabilities: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)


def room_label_space(
    known: Mapping[int, str], used: Iterable[str], labels: Iterable[str]
) -> tuple[dict[str, int], list[list[Any]]]:
    """An id for each room label, and the label space to write, as ``[id, name]`` pairs.

    A graph's own room label space keeps its ids and gains the ``used`` labels that it lacks; where
    it has none, all ``labels`` get ids from 1, and 0 is unknown, as Hydra numbers unlabelled rooms.
    """
    ids: dict[str, int] = {}
    for number, name in known.items():
        for part in name.split(";"):
            ids.setdefault(part.strip(), number)
    pairs: list[list[Any]] = [[number, name] for number, name in known.items()]
    pairs = pairs or [[UNKNOWN_LABEL, "unknown"]]
    for label in sorted({*used} if known else {*used, *labels}):
        if label not in ids:
            ids[label] = max(number for number, _ in pairs) + 1
            pairs.append([ids[label], label])
    return ids, pairs


def label_rooms(
    document: dict[str, Any], graph: Graph, named: Mapping[str, NamedRoom], labels: Iterable[str]
) -> None:
    """Write names into the graph's JSON, in place; rooms without an answer keep what they have.

    ``named`` goes by the rooms' symbols (``R0``); ``labels`` are all the rooms that could have been
    the answer.
    """
    if not named:
        return
    space = f"_l{graph.room_layer}p0"
    known = graph.label_spaces.get(space, {})
    ids, pairs = room_label_space(known, {room.label for room in named.values()}, labels)
    if len(pairs) > len(known):
        _child(_child(document, "metadata"), "labelspaces")[space] = pairs
    for key in graph.rooms:
        room = named.get(symbol(key))
        if room is not None:
            attributes = graph.attributes(key)
            attributes["name"] = room.label
            attributes["semantic_label"] = ids[room.label]
            attributes["semantic_class_probabilities"] = dict(room.probabilities)
            _child(attributes, "metadata")["roomtables"] = dict(room.provenance)


def _child(value: dict[str, Any], key: str) -> dict[str, Any]:
    """The dictionary under a key, made where there is none."""
    if not isinstance(value.get(key), dict):
        value[key] = {}
    child: dict[str, Any] = value[key]
    return child
