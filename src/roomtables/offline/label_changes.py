"""How a label space changed, as a person would say it: "object toilet renamed to commode"."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.labels import LabelSpace, names_of_objects
from roomtables.storage.versions import Version

_NAMED = 3  # labels that are named; the others are counted


@dataclass(frozen=True)
class Labels:
    """What a label space says, as far as the tables of a version hold it.

    Attributes
    ----------
    objects : label → plural
    rooms : label → article, and whether it is predicted
    names : every name of an object → its label
    """

    objects: Mapping[str, str]
    rooms: Mapping[str, tuple[str, bool]]
    names: Mapping[str, str]

    @classmethod
    def of_space(cls, space: LabelSpace) -> Labels:
        """Those of a label space."""
        return cls(
            {o.label: o.plural for o in space.objects},
            {r.label: (r.article, r.predicted) for r in space.rooms},
            {name: found.label for name, found in names_of_objects(space.objects).items()},
        )

    @classmethod
    def of_version(cls, version: Version) -> Labels | None:
        """Those of a version; ``None`` where its tables cannot be read."""
        try:
            objects, rooms, names = (
                pq.read_table(version.path / f"{table}.parquet").to_pylist()
                for table in ("objects", "rooms", "names")
            )
            return cls(
                {row["label"]: row["plural"] for row in objects},
                {row["label"]: (row["article"], row["predicted"]) for row in rooms},
                {row["name"]: row["object"] for row in names},
            )
        except (pa.ArrowException, OSError, LookupError):
            return None


@dataclass(frozen=True)
class LabelChanges:
    """What differs between two label spaces."""

    before: Labels
    after: Labels

    @cached_property
    def same_objects(self) -> dict[str, str]:
        """Objects that bear another label now, which is among their names: old → new label."""
        before, after = self.before, self.after
        came = set(after.objects) - set(before.objects)
        found: dict[str, str] = {}
        for old in sorted(set(before.objects) - set(after.objects)):
            by_name = {new for new in came if before.names.get(new) == old}
            for new in sorted({after.names.get(old, ""), *by_name} & came - set(found.values())):
                found.setdefault(old, new)
        return found

    @property
    def renamed_objects(self) -> dict[str, str]:
        """The same; and where one went and one came, it is taken for that one renamed."""
        return self.same_objects or _only_one(self.before.objects, self.after.objects)

    @property
    def renamed_rooms(self) -> dict[str, str]:
        """A room that went and the one that came instead: old label → new label."""
        return _only_one(self.before.rooms, self.after.rooms)

    def of_objects(self) -> list[str]:
        """How ``objects.csv`` changed."""
        before, after = self.before, self.after
        said = _of_set("object", before.objects, after.objects, self.renamed_objects)
        if said:
            return said
        plurals = [o for o in after.objects if after.objects[o] != before.objects[o]]
        if plurals:
            return [f"plural of {_few(plurals)} changed"]
        names = before.names.items() ^ after.names.items()
        return [f"synonyms of {_few({label for _, label in names})} changed"] if names else []

    def of_rooms(self) -> list[str]:
        """How ``rooms.csv`` changed."""
        before, after = self.before.rooms, self.after.rooms
        return _of_set("room", before, after, self.renamed_rooms) or _of_rows(before, after)


def _only_one(before: Iterable[str], after: Iterable[str]) -> dict[str, str]:
    """The label that went and the one that came, where there is one of each."""
    gone, came = set(before) - set(after), set(after) - set(before)
    return dict(zip(gone, came, strict=True)) if len(gone) == len(came) == 1 else {}


def _of_set(
    kind: str, before: Iterable[str], after: Iterable[str], renames: Mapping[str, str]
) -> list[str]:
    came = set(after) - set(before) - set(renames.values())
    gone = set(before) - set(after) - set(renames)
    if len(renames) > 1:
        return [f"{len(renames):,} {kind}s renamed", *_of_set(kind, gone, came, {})]
    said = [f"{kind} {old} renamed to {new}" for old, new in renames.items()]
    for labels, how in ((came, "added"), (gone, "removed")):
        if labels:
            said.append(f"{kind}{'s' if len(labels) > 1 else ''} {_few(labels)} {how}")
    return said


def _of_rows(
    before: Mapping[str, tuple[str, bool]], after: Mapping[str, tuple[str, bool]]
) -> list[str]:
    """How the rows of the same rooms changed."""
    said = []
    for predicted, how in ((True, "predicted"), (False, "no longer predicted")):
        rooms = [r for r, row in after.items() if row[1] is predicted is not before[r][1]]
        if rooms:
            said.append(f"room{'s' if len(rooms) > 1 else ''} {_few(rooms)} {how}")
    articles = [r for r, row in after.items() if row[0] != before[r][0]]
    if articles:
        said.append(f"article of {_few(articles)} changed")
    return said


def _few(labels: Iterable[str]) -> str:
    shown = sorted(labels)
    more = len(shown) - _NAMED
    return ", ".join(shown[:_NAMED]) + (f" and {more:,} more" if more > 0 else "")
