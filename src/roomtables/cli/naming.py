"""What the commands share that write names into scene graphs: label and serve."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import click

from roomtables import __version__
from roomtables.online.classifier import RoomTables
from roomtables.online.prediction import Prediction
from roomtables.online.steady_names import SteadyName
from roomtables.scenes.dsg import NamedRoom
from roomtables.scenes.live import LiveGraph

_MOST_NAMES = 2_048  # names that a Namer remembers

keep_names_option = click.option(
    "--keep-names",
    is_flag=True,
    help="Leave rooms alone that a person or another program has named.",
)


class Namer:
    """Makes names of answers; one that was made before costs a dictionary lookup."""

    def __init__(self, tables: RoomTables) -> None:
        manifest = tables.version.manifest
        self._shared = {
            "model": manifest.query_scorer_id or manifest.scorer_id,
            "labels": manifest.labels,
            "version": tables.version.name,
            "roomtables": __version__,
        }
        # By the answer's identity; each entry holds it, so that no other can take its id.
        self._named: OrderedDict[tuple[int, str], tuple[Prediction, NamedRoom]] = OrderedDict()

    def __call__(self, answers: Mapping[str, Prediction]) -> dict[str, NamedRoom]:
        """A name for each answered room, with what a reader of the graph needs to judge it."""
        return {key: self._name(a.room, a) for key, a in answers.items() if a.room is not None}

    def steady(self, names: Mapping[str, SteadyName]) -> dict[str, NamedRoom | None]:
        """The same for names that `SteadyNames` decided; ``None`` where one is taken away."""
        return {
            key: None if name.label is None else self._name(name.label, name.answer)
            for key, name in names.items()
        }

    def _name(self, label: str, answer: Prediction) -> NamedRoom:
        key = id(answer), label
        known = self._named.get(key)
        if known is None:
            provenance = _provenance(label, answer) | self._shared
            known = self._named[key] = answer, NamedRoom(label, answer.probabilities, provenance)
            if len(self._named) > _MOST_NAMES:
                self._named.popitem(last=False)
        else:
            self._named.move_to_end(key)
        return known[1]


def room_namer(tables: RoomTables) -> Callable[[LiveGraph, Mapping[str, SteadyName]], None]:
    """What writes the names that `SteadyNames` decided into a message's graph."""
    candidates, namer = [room.label for room in tables.candidates], Namer(tables)

    def name_rooms(graph: LiveGraph, names: Mapping[str, SteadyName]) -> None:
        graph.name_rooms(namer.steady(names), candidates)

    return name_rooms


def _provenance(label: str, answer: Prediction) -> dict[str, Any]:
    """How a name came about; of one that is held against a newer answer, also what that is."""
    held = {} if label == answer.room else {"held": True, "best": answer.room}
    return {
        "label": label,
        "probability": answer.probabilities.get(label),
        "objects": list(answer.objects),
        "rule": answer.rule,
        "source": answer.source,
        "answered_by": answer.answered_by,
        "read_as": answer.read_as,
        "unknown_objects": list(answer.unknown_objects),
        **held,
    }
