"""Views of what is not in one version alone: all versions, saved evaluations, misses."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from roomtables.errors import StoreError, first_line
from roomtables.schemas import TABLE_BY_NAME, VERSION_TABLES, literal, parquet
from roomtables.storage.evaluations import FOLDER as EVALUATIONS
from roomtables.storage.files import listed, refuse_outside
from roomtables.storage.misses import Misses
from roomtables.storage.samples import check_parquet
from roomtables.storage.versions import SpaceFolder, Version

log = logging.getLogger(__name__)
_NOTED = "one row per combination asked for in vain, whether or not a build has taken it in"
_UNPIVOTED = (
    "select source, objects, room, score::double as score from (unpivot (from {table}) "
    "on columns(* exclude (source, key, objects)) into name room value score)"
)


class View(NamedTuple):
    """A view: its name, the SELECT that it is, and what it holds."""

    name: str
    query: str
    holds: str


def published_versions(space: SpaceFolder, current: Version, verify: bool) -> list[Version]:
    """The versions that can be read, oldest first, the published one among them.

    Raises
    ------
    StoreError
        A Parquet file of the published version is damaged. (Another version that is damaged, or of
        another schema version, is left out with a warning.)
    """
    _check(current, verify)
    found = [current]
    for path in space.versions():
        if path.name == current.name:
            continue
        try:
            other = Version.open(path)
            _check(other, verify)
        except StoreError as error:
            log.warning("left out of the views of versions: %s", error)
            continue
        found.append(other)
    return sorted(found, key=lambda version: version.name)


def _check(version: Version, verify: bool) -> None:
    if not {f"{name}.parquet" for name in VERSION_TABLES} <= version.manifest.files.keys():
        raise StoreError(
            f"{version.path} holds no Parquet tables, as those packed by `export`; run "
            "`roomtables sql` where they were built"
        )
    check_parquet(version, verify)


def version_views(versions: Sequence[Version], current: Version) -> Iterator[View]:
    """``versions``, and the tables of all versions that ``version_changes`` compares."""
    yield View(
        "versions",
        " union all ".join(_version_row(version, version is current) for version in versions),
        "one row per version of the label space: how and when it was built",
    )
    for table in ("cooccurrence", "entropy"):
        yield View(
            f"version_{table}",
            _of_all(versions, table, "from {table}"),
            f"{TABLE_BY_NAME[table].grain}, in each version",
        )
    yield View(
        "version_scores",
        _of_all(versions, "query_scores", _UNPIVOTED),
        "one row per version, source, combination, predicted room: the score in nats",
    )


def _version_row(version: Version, published: bool) -> str:
    manifest, settings = version.manifest, version.manifest.settings
    created = manifest.created.replace(tzinfo=None)
    values = {
        "version": literal(version.name),
        "created": f"{literal(created.isoformat(sep=' '))}::timestamp",
        "published": str(published).lower(),
        "model": literal(settings.model),
        "scorer_id": literal(manifest.scorer_id),
        "query_scorer_id": _text(manifest.query_scorer_id),
        "source": literal(settings.source),
        "rule": literal(settings.rule),
        "prior_weight": f"{settings.prior_weight!r}::double",
        "evidence_power": f"{settings.evidence_power!r}::double",
        "k": str(settings.k),
        "reduction": literal(settings.reduction),
        "template": literal(" | ".join(settings.template)),
        "scored": literal(settings.scored),
        "objects": str(manifest.objects),
        "rooms": str(manifest.rooms),
        "combinations": f"{sum(manifest.combinations.values())}::bigint",
        "seconds": f"{manifest.seconds!r}::double",
    }
    return "select " + ", ".join(f"{value} as {name}" for name, value in values.items())


def _of_all(versions: Sequence[Version], table: str, query: str) -> str:
    """A table of every version, one below the other."""
    parts = []
    for version in versions:
        path = version.path.resolve() / f"{table}.parquet"
        rows = query.format(table=parquet(path))
        parts.append(f"select {literal(version.name)} as version, * from ({rows})")
    return " union all by name ".join(parts)


def _text(value: str | None) -> str:
    return "null::varchar" if value is None else literal(value)


def evaluations_view(space: SpaceFolder) -> View:
    """All rows of the saved evaluations; a file that does not hold them is left out with a warning.

    Raises
    ------
    StoreError
        The folder may not be read, or a file in it is a link out of the tables.
    """
    folder, table = space.path / EVALUATIONS, TABLE_BY_NAME[EVALUATIONS]
    paths = [path for path in listed(folder) if path.suffix == ".parquet" and path.name[0] != "."]
    refuse_outside(space.path.parent, folder, *paths)
    names = [column.name for column in table.columns]
    readable = [path.resolve() for path in paths if _holds(path, names)]
    values = "{0}" if readable else "null"
    columns = ", ".join(
        f"{values.format(column.name)}::{column.type} as {column.name}" for column in table.columns
    )
    rows = f"from {parquet(*readable)}" if readable else "where false"
    return View(EVALUATIONS, f"select {columns} {rows}", table.grain)


def _holds(path: Path, columns: Sequence[str]) -> bool:
    """Whether a Parquet file can be read and has the columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with path.open("rb") as file:
            missing = set(columns) - set(pq.read_schema(file).names)
        why = f"it lacks {', '.join(sorted(missing))}" if missing else ""
    except (OSError, pa.ArrowException) as error:
        why = first_line(error)
    if why:
        log.warning("%s is left out: %s; run `roomtables evaluate --save` again", path, why)
    return not why


def note_misses(connection: Any, found: Misses) -> None:
    """Create table ``noted_misses`` of what was asked in vain, as of now."""
    import pyarrow as pa

    types = {"source": pa.string(), "objects": pa.list_(pa.string()), "times_asked": pa.int64()}
    types |= {"last_asked": pa.timestamp("us"), "taken_in": pa.bool_()}
    rows = [
        miss._asdict() | {"last_asked": miss.last_asked.replace(tzinfo=None), "taken_in": False}
        for miss in found.open
    ]
    still_open = {(miss.source, miss.objects) for miss in found.open}
    rows += [
        {"source": source, "objects": objects, "taken_in": True}
        for source, objects in sorted(found.taken - still_open)
    ]
    connection.register("noted", pa.Table.from_pylist(rows, pa.schema(list(types.items()))))
    connection.execute("create table noted_misses as select * from noted")
    connection.execute(f"comment on table noted_misses is {literal(_NOTED)}")
    connection.unregister("noted")


def open_misses_view() -> View:
    """The misses that no build has taken in."""
    return View(
        "misses",
        "select * exclude (taken_in) from noted_misses where not taken_in",
        TABLE_BY_NAME["misses"].grain,
    )
