"""A language model's common sense about rooms, as tables.

Offline, ``build`` asks a language model and writes tables; online, ``RoomTables`` labels a room by
a lookup.

>>> from roomtables import RoomTables, build
>>> report = build(labels="mpcat40", combinations="none")  # into ./tables, by the embedded model
>>> report.sentences_scored  # "A room containing toilets is called a bathroom.", …
945
>>> tables = RoomTables.open("tables", labels="mpcat40")
>>> prediction = tables.classify(["toilet", "sink", "towel"])
>>> prediction.room, prediction.answered_by  # no table holds these three, so the model was asked
('bathroom', 'lm')

Names are loaded on first use, so that a robot imports numpy and nothing heavier.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roomtables.evaluation import Evaluation as Evaluation
    from roomtables.evaluation import evaluate as evaluate
    from roomtables.offline.builder import BuildReport as BuildReport
    from roomtables.offline.builder import build as build
    from roomtables.online.classifier import RoomTables as RoomTables
    from roomtables.online.prediction import Prediction as Prediction

__version__ = "0.1.0"

_HOMES = {
    "BuildReport": "roomtables.offline.builder",
    "Evaluation": "roomtables.evaluation",
    "Prediction": "roomtables.online.prediction",
    "RoomTables": "roomtables.online.classifier",
    "build": "roomtables.offline.builder",
    "evaluate": "roomtables.evaluation",
}
__all__ = ["BuildReport", "Evaluation", "Prediction", "RoomTables", "build", "evaluate"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'roomtables' has no attribute {name!r}")
    from importlib import import_module

    from roomtables.errors import needing

    with needing(f"roomtables.{name}", "lm" if name == "build" else None):
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
