"""What changed between two versions: objects whose entropy or first room moved, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import duckdb

from roomtables.schemas import parquet
from roomtables.storage.database import connect
from roomtables.storage.manifest import Manifest
from roomtables.storage.versions import Version

_SETTINGS = (
    "template", "reduction", "smoothing", "k", "source", "rule", "prior_weight", "evidence_power",
)  # fmt: skip
# Entropies (nats) that differ by less are equal: sums are not taken in one order everywhere.
_TOLERANCE = 1e-9
# One row per source and object: its entropy and the room it speaks for most.
_OBJECTS = """
select source, object, any_value(entropy_nats) as entropy_nats,
    first(room order by p_room_given_object desc, room) as first_room
from {cooccurrence} as c join {entropy} as e using (source, object)
group by source, object
"""
_MOVED = """
select source, object,
    before.entropy_nats as entropy_before, after.entropy_nats as entropy_after,
    after.entropy_nats - before.entropy_nats as entropy_change,
    before.first_room as first_room_before, after.first_room as first_room_after
from ({before}) as before full join ({after}) as after using (source, object)
where coalesce(abs(entropy_change) > {tolerance}, true)
    or before.first_room is distinct from after.first_room
order by before.first_room is not distinct from after.first_room,
    abs(entropy_change) desc nulls first, source, object
"""
# One row per source and combination: its best room; a tie goes to the room that sorts first.
_ANSWERS = """
select source, list_sort(objects) as objects, first(room order by score desc, room) as best_room
from (
    unpivot (from {query_scores})
    on columns(* exclude (source, key, objects)) into name room value score
)
group by source, key, objects
"""
_COMBINATIONS = """
select source,
    count(*) filter (before.best_room is not null and after.best_room is not null) as held_in_both,
    count(*) filter (before.best_room is null) as added,
    count(*) filter (after.best_room is null) as removed,
    count(*) filter (before.best_room <> after.best_room) as other_room
from ({before}) as before full join ({after}) as after using (source, objects)
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
        another best room
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
    versions = {"before": before, "after": after}
    objects = {when: _from_files(_OBJECTS, version) for when, version in versions.items()}
    answers = {when: _from_files(_ANSWERS, version) for when, version in versions.items()}
    with connect() as connection:
        return Diff(
            after.manifest.labels,
            before.name,
            after.name,
            _changed_settings(before.manifest, after.manifest),
            _rows(connection, _MOVED.format(**objects, tolerance=_TOLERANCE)),
            _rows(connection, _COMBINATIONS.format(**answers)),
        )


def _changed_settings(before: Manifest, after: Manifest) -> dict[str, tuple[Any, Any]]:
    values = [
        {"scorer_id": manifest.scorer_id, "query_scorer_id": manifest.query_scorer_id}
        | {name: manifest.settings.recorded()[name] for name in _SETTINGS}
        for manifest in (before, after)
    ]
    was, now = values
    return {name: (was[name], now[name]) for name in was if was[name] != now[name]}


def _from_files(query: str, version: Version) -> str:
    """A query over the tables of a version."""
    names = ("cooccurrence", "entropy", "query_scores")
    return query.format(**{name: parquet(version.path / f"{name}.parquet") for name in names})


def _rows(connection: duckdb.DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    found = connection.execute(query)
    columns = [column[0] for column in found.description or ()]
    return [dict(zip(columns, row, strict=True)) for row in found.fetchall()]
