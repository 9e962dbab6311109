"""What is said of the names in a scene: which stand for another object, which nobody knows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from roomtables.cli.printing import echo, in_one_line
from roomtables.labels import SYNONYM
from roomtables.names import COMPOUND, NameReader
from roomtables.online.classifier import RoomTables
from roomtables.online.complaints import shortened
from roomtables.online.prediction import Prediction
from roomtables.scenes.scene import Scene, SceneRoom

_MOST_SHOWN = 12  # names on a line
_LONGEST_SHOWN = 40  # characters of a name
_MOST_KEPT = 65_536  # distinct names, so that no stream of them fills the memory


class NameReport:
    """Collects the names of objects, and tells on stderr how they were read.

    Parameters
    ----------
    reader : what reads the names
    labels : the label space that they are read as objects of
    """

    def __init__(self, reader: NameReader, labels: str) -> None:
        self._reader = reader
        self._labels = labels
        self._given: Counter[str] = Counter()
        self._unknown: Counter[str] = Counter()
        self._asked: Counter[str] = Counter()

    @classmethod
    def of(cls, tables: RoomTables) -> NameReport:
        """A report on what is asked of some tables."""
        return cls(tables.names, tables.version.manifest.labels)

    def watch(self, scenes: Iterable[Scene]) -> Iterator[Scene]:
        """The scenes, unchanged; their names are taken in as their rooms are asked for."""
        for scene in scenes:
            yield replace(scene, rooms=self._watch(scene.rooms))

    def take(self, prediction: Prediction) -> None:
        """Take in the names of a room that was answered."""
        names = Counter(prediction.given)
        _add(self._given, names)
        _add(self._unknown, {name: names[name] for name in prediction.unknown_objects})
        if prediction.unlisted:
            unread = {name for name in names if name.strip() and self._reader.read(name) is None}
            asked = unread.difference(prediction.unknown_objects)
            _add(self._asked, {name: names[name] for name in asked})

    def print(self) -> None:
        """Tell what was read as something else, what only the model knows, what is unknown."""
        if other := list(self._read_otherwise()):
            more = ", …" if len(other) > _MOST_SHOWN else ""
            echo(f"read as: {', '.join(other[:_MOST_SHOWN])}{more}", err=True)
        told = f"not in label space {self._labels}, so the model was asked"
        self._tell(told, self._asked)
        self.print_unknown()

    def print_unknown(self) -> None:
        """Tell what is unknown."""
        self._tell(f"unknown to label space {self._labels}", self._unknown)

    def _tell(self, what: str, counted: Counter[str]) -> None:
        """Name the most frequent of some names, with the nearest that are known."""
        if counted:
            shown = counted.most_common(_MOST_SHOWN)
            more = f", … ({len(counted)} in all)" if len(counted) > len(shown) else ""
            names = ", ".join(self._suggested(name, times) for name, times in shown)
            echo(f"{what}: {names}{more}", err=True)

    def _watch(self, rooms: Iterable[SceneRoom]) -> Iterator[SceneRoom]:
        for room in rooms:
            names = Counter(room.as_room().objects)
            unread = {name for name in names if name.strip() and self._reader.read(name) is None}
            _add(self._unknown, {name: names[name] for name in unread})
            yield room

    def _read_otherwise(self) -> Iterator[str]:
        """Synonyms and compounds; that a plural or ``chair_12`` is read goes without saying."""
        for name in sorted(self._given):
            found = self._reader.read(name)
            if found is not None and found.how in {SYNONYM, COMPOUND}:
                yield f"{_shown(name)} = {found.label}"

    def _suggested(self, name: str, times: int) -> str:
        """A name with how often it was given, and the nearest known ones."""
        near = self._reader.nearest(name, 2)
        guess = f" ({' or '.join(near)}?)" if near else ""
        often = f" {times} times" if times > 1 else ""
        return f'"{_shown(name)}"{often}{guess}'


def _add(counts: Counter[str], names: Mapping[str, int]) -> None:
    for name, times in names.items():
        if name in counts or len(counts) < _MOST_KEPT:
            counts[name] += times


def _shown(name: str) -> str:
    """A name as a line can hold it."""
    return in_one_line(shortened(name, _LONGEST_SHOWN))
