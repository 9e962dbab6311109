"""What changed between two versions: objects whose entropy or first room moved, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import duckdb

from roomtables.offline.cache import quote
from roomtables.store import Version

_SETTINGS = ("scorer_id", "query_scorer_id", "k", "template", "reduction", "smoothing", "decision")
# One row per source and object: its entropy and the room it speaks for most.
_OBJECTS = """
select source, object, any_value(entropy_nats) as entropy_nats,
    first(room order by p_room_given_object desc, room) as first_room
from read_parquet({cooccurrence}) as c join read_parquet({entropy}) as e using (source, object)
group by source, object
"""
_MOVED = """
select source, object,
    before.entropy_nats as entropy_before, after.entropy_nats as entropy_after,
    after.entropy_nats - before.entropy_nats as entropy_change,
    before.first_room as first_room_before, after.first_room as first_room_after
from ({before}) as before full join ({after}) as after using (source, object)
where before.entropy_nats is distinct from after.entropy_nats
    or before.first_room is distinct from after.first_room
order by before.first_room is not distinct from after.first_room,
    abs(entropy_change) desc nulls first, source, object
"""
# A combination's answer is the position of its best room; a tie goes to the room that sorts first.
_COMBINATIONS = """
select source,
    count(*) filter (before.objects is not null and after.objects is not null) as held_in_both,
    count(*) filter (before.objects is null) as added,
    count(*) filter (after.objects is null) as removed,
    count(*) filter (
        list_position(before.scores, list_max(before.scores))
        <> list_position(after.scores, list_max(after.scores))
    ) as other_room
from (select source, list_sort(objects) as objects, scores from read_parquet({before})) as before
full join (select source, list_sort(objects) as objects, scores from read_parquet({after})) as after
    using (source, objects)
group by source
order by source
"""


@dataclass(frozen=True)
class Diff:
    """Two versions compared.

    Attributes
    ----------
    settings : name → (before, after), where they differ
    objects : rows of objects that moved, those with another first room first, then by how much
        their entropy (nats) changed
    combinations : per source, how many combinations are held in both, added, removed, and have
        another best room; empty where the rooms differ
    """

    labels: str
    before: str
    after: str
    settings: Mapping[str, tuple[Any, Any]]
    objects: list[dict[str, Any]]
    combinations: list[dict[str, Any]]

    def as_json(self) -> dict[str, Any]:
        """The comparison as plain data."""
        return asdict(self)


def compare(before: Version, after: Version) -> Diff:
    """What changed from one version to another of the same label space.

    Raises
    ------
    StoreError
        A table of a version is damaged.
    """
    before.verify()
    after.verify()
    moved = _MOVED.format(before=_objects(before), after=_objects(after))
    same_rooms = before.manifest["predicted_rooms"] == after.manifest["predicted_rooms"]
    counts = _COMBINATIONS.format(
        before=quote(before.path / "query_scores.parquet"),
        after=quote(after.path / "query_scores.parquet"),
    )
    with duckdb.connect() as connection:
        return Diff(
            after.manifest["labels"],
            before.name,
            after.name,
            {
                name: (before.manifest.get(name), after.manifest.get(name))
                for name in _SETTINGS
                if before.manifest.get(name) != after.manifest.get(name)
            },
            _rows(connection, moved),
            _rows(connection, counts) if same_rooms else [],
        )


def _objects(version: Version) -> str:
    names = ("cooccurrence", "entropy")
    return _OBJECTS.format(**{name: quote(version.path / f"{name}.parquet") for name in names})


def _rows(connection: duckdb.DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    found = connection.execute(query)
    columns = [column[0] for column in found.description or ()]
    return [dict(zip(columns, row, strict=True)) for row in found.fetchall()]
