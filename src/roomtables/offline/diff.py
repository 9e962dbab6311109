"""What changed between two versions: why, and which objects and answers that moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import duckdb

from roomtables.offline.causes import DECIDES, Comparison, Made, joined
from roomtables.schemas import parquet
from roomtables.storage.database import connect
from roomtables.storage.manifest import Manifest
from roomtables.storage.versions import Version

_SETTINGS = (
    "template", "scored", "reduction", "smoothing", "k", "source", "rule", "prior_weight",
    "evidence_power",
)  # fmt: skip
# Numbers (nats, probabilities) that differ by less are equal: sums are not taken in one order
# everywhere.
_TOLERANCE = 1e-9
# One row per source and object: its entropy and the rooms it speaks for most.
_OBJECTS = """
select source, object, any_value(entropy_nats) as entropy_nats,
    list(room order by room) filter (where p_room_given_object >= highest - {tolerance}) as first
from (
    select source, coalesce(o.new, object) as object, coalesce(r.new, room) as room, entropy_nats,
        p_room_given_object,
        max(p_room_given_object) over (partition by source, object) as highest
    from {cooccurrence} as c join {entropy} as e using (source, object)
    left join renamed_objects as o on o.old = object and {renamed}
    left join renamed_rooms as r on r.old = room and {renamed}
)
group by source, object
"""
_MOVED = """
select source, object,
    before.entropy_nats as entropy_before, after.entropy_nats as entropy_after,
    after.entropy_nats - before.entropy_nats as entropy_change,
    before.first[1] as first_room_before,
    case when list_has_any(before.first, after.first) then before.first[1]
        else after.first[1] end as first_room_after
from ({before}) as before full join ({after}) as after using (source, object)
where coalesce(abs(entropy_change) > {tolerance}, true)
    or first_room_before is distinct from first_room_after
order by count(entropy_before) over (partition by source) = 0
    or count(entropy_after) over (partition by source) = 0,
    first_room_before is not distinct from first_room_after,
    abs(entropy_change) desc nulls first, source, object
"""
# One row per source and combination: its best rooms.
_ANSWERS = """
select source, objects, list(coalesce(r.new, room) order by room) filter (
    where score >= highest - {tolerance}) as best
from (
    select source, key, room, score,
        list_sort(list_transform(objects, lambda o: coalesce(renamed[o], o))) as objects,
        max(score) over (partition by source, key) as highest
    from (
        unpivot (from {query_scores})
        on columns(* exclude (source, key, objects)) into name room value score
    )
    cross join (
        select map(coalesce(list(old), []), coalesce(list(new), [])) as renamed
        from renamed_objects where {renamed}
    )
)
left join renamed_rooms as r on r.old = room and {renamed}
group by source, key, objects
"""
_COMBINATIONS = """
select source,
    count(*) filter (before.best is not null and after.best is not null) as held_in_both,
    count(*) filter (before.best is null) as added,
    count(*) filter (after.best is null) as removed,
    count(*) filter (not list_has_any(before.best, after.best)) as other_room
from ({before}) as before full join ({after}) as after using (source, objects)
group by source
order by source
"""


@dataclass(frozen=True)
class Diff:
    """Two versions compared by label; what bears another label now is compared under that one.

    Attributes
    ----------
    causes : what changed in what the tables are made from, as a person would say it
    settings : name → (before, after), where they differ
    groups : per source and cause, how many objects moved, came or went; how many of those that
        stayed have another first room, and the largest change of their entropies (nats)
    objects : rows of objects that moved, each with its cause; those with another first room first,
        then by how much their entropy (nats) changed; a source that came or went last
    combinations : per source, how many combinations are held in both, added, removed, and have
        another best room
    """

    labels: str
    before: str
    after: str
    causes: tuple[str, ...]
    settings: Mapping[str, tuple[Any, Any]]
    groups: list[dict[str, Any]]
    objects: list[dict[str, Any]]
    combinations: list[dict[str, Any]]

    @property
    def nothing_moved(self) -> bool:
        """Whether no object and no combination is another than it was."""
        changed = ("added", "removed", "other_room")
        return not self.objects and not any(r[key] for r in self.combinations for key in changed)

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
    compared = Comparison(Made.of(before), Made.of(after))
    versions = {"before": before, "after": after}
    objects = {when: _from_files(_OBJECTS, version, when) for when, version in versions.items()}
    answers = {when: _from_files(_ANSWERS, version, when) for when, version in versions.items()}
    labels = compared.labels
    with connect() as connection:
        _load_renamed(connection, "objects", labels.same_objects if labels else {})
        _load_renamed(connection, "rooms", labels.renamed_rooms if labels else {})
        moved = _rows(connection, _MOVED.format(**objects, tolerance=_TOLERANCE))
        combinations = _rows(connection, _COMBINATIONS.format(**answers))
    causes = _causes(compared)
    moved = [row | {"cause": _cause(row, causes, versions)} for row in moved]
    return Diff(
        after.manifest.labels,
        before.name,
        after.name,
        tuple(dict.fromkeys(cause for _, cause in causes if cause)),
        _changed_settings(before.manifest, after.manifest),
        _groups(moved),
        moved,
        combinations,
    )


def _load_renamed(
    connection: duckdb.DuckDBPyConnection, kind: str, renamed: Mapping[str, str]
) -> None:
    """Old and new labels, as a table."""
    connection.execute(f"create table renamed_{kind} (old varchar, new varchar)")
    for labels in renamed.items():
        connection.execute(f"insert into renamed_{kind} values (?, ?)", labels)


def _causes(compared: Comparison) -> list[tuple[str, str]]:
    """What each stage read that changed, and how, in the order of the stages."""
    stages = compared.after.stages
    return [change for stage in stages for change in compared.causes(stage).items()]


def _cause(
    row: Mapping[str, Any], causes: Iterable[tuple[str, str]], versions: Mapping[str, Version]
) -> str:
    """Why an object moved, as far as the sources' inputs tell."""
    source = row["source"]
    in_both = all(source in version.manifest.combinations for version in versions.values())
    one_side = row["entropy_before"] is None or row["entropy_after"] is None
    reads = {"objects.csv"} if in_both and one_side else DECIDES[source]
    return joined(cause for read, cause in causes if read in reads) or "scored again"


def _groups(moved: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in moved:
        key = (row["source"], row["cause"])
        group = found.setdefault(
            key,
            {"source": key[0], "cause": key[1], "objects": 0, "other_first_room": 0}
            | {"largest_entropy_change": 0.0},
        )
        group["objects"] += 1
        if row["entropy_change"] is not None:
            group["other_first_room"] += row["first_room_before"] != row["first_room_after"]
            change = abs(row["entropy_change"])
            group["largest_entropy_change"] = max(group["largest_entropy_change"], change)
    return [found[key] for key in sorted(found)]


def _changed_settings(before: Manifest, after: Manifest) -> dict[str, tuple[Any, Any]]:
    values = [
        {"scorer_id": manifest.scorer_id, "query_scorer_id": manifest.query_scorer_id}
        | {name: manifest.settings.recorded()[name] for name in _SETTINGS}
        for manifest in (before, after)
    ]
    was, now = values
    return {name: (was[name], now[name]) for name in was if was[name] != now[name]}


def _from_files(query: str, version: Version, when: str) -> str:
    """A query over the tables of a version; labels of the one ``before`` as they are now."""
    names = ("cooccurrence", "entropy", "query_scores")
    files = {name: parquet(version.path / f"{name}.parquet") for name in names}
    renamed = "true" if when == "before" else "false"
    return query.format(**files, renamed=renamed, tolerance=_TOLERANCE)


def _rows(connection: duckdb.DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    found = connection.execute(query)
    columns = [column[0] for column in found.description or ()]
    return [dict(zip(columns, row, strict=True)) for row in found.fetchall()]
