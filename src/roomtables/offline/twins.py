"""Derive the lookup twin of a version from its tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
from numpy.typing import NDArray

from roomtables.labels import LabelSpace
from roomtables.schemas import PROXY
from roomtables.twin import write_twin


def derive_twin(
    connection: duckdb.DuckDBPyConnection,
    folder: Path,
    labels: LabelSpace,
    settings: Mapping[str, Any],
) -> None:
    """Write ``lookup/`` from the tables of the stages before it."""
    found = connection.execute("select distinct source from cooccurrence order by source")
    sources = [source for (source,) in found.fetchall()]
    write_twin(folder, labels, settings, {s: _arrays(connection, s, labels) for s in sources})


def _arrays(
    connection: duckdb.DuckDBPyConnection, source: str, labels: LabelSpace
) -> dict[str, NDArray[Any]]:
    evidence = "score" if source == PROXY else "ln(p_room_given_object)"
    object_room = _column(
        connection,
        f"select case when p_room_given_object > 0 then {evidence} else '-inf'::double end "
        "from cooccurrence where source = ? order by object, room",
        source,
    )
    # Compared as numbers; the tables hold each room's bias once, whatever the source.
    bias = _column(
        connection, "select bias_nats from room_bias where source = ? order by room", source
    )
    scores = _column(
        connection,
        "select unnest(scores) from query_scores where source = ? order by source, key",
        source,
    )
    predicted = len(labels.predicted_rooms)
    return {
        "entropy": _column(
            connection, "select entropy_nats from entropy where source = ? order by object", source
        ),
        "ranks": _column(
            connection, "select rank from entropy where source = ? order by object", source
        ),
        "object_room": object_room.reshape(len(labels.objects), len(labels.rooms)),
        "bias": bias if len(bias) else np.zeros(predicted),
        "keys": _column(
            connection, "select key from query_scores where source = ? order by source, key", source
        ),
        "scores": scores.reshape(-1, predicted),
    }


def _column(connection: duckdb.DuckDBPyConnection, query: str, source: str) -> NDArray[Any]:
    """The one column of a query, as an array."""
    (values,) = connection.execute(query, [source]).fetchnumpy().values()
    return np.asarray(values)
