"""Saved evaluations: a Parquet file each, in ``evaluations/`` beside a label space's versions.

They outlive the versions that were evaluated: `gc` leaves them alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, needing
from roomtables.schemas import TABLE_BY_NAME
from roomtables.storage.files import refuse_outside, write_aside, writing

FOLDER = "evaluations"
_NAME = re.compile(r"\w([\w .+-]{0,98}\w)?")


def check_evaluation_name(name: str) -> None:
    """Refuse a name that cannot be a file's in every system.

    Raises
    ------
    InputError
        It is empty, too long, or has a sign that is no letter, digit, ``_``, ``-``, ``+``, ``.`` or
        space.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"--save: {name!r} is no plain name; give up to 100 letters, digits, `-`, `_`, such as "
            "`--save nightly-1`"
        )


def save_evaluation(space: Path, name: str, rows: Iterable[Mapping[str, Any]]) -> tuple[Path, bool]:
    """Write the rows of table ``evaluations``; the file, and whether there was one before.

    Parameters
    ----------
    space : the folder of the label space
    name : the evaluation's name; one of the same name is replaced
    rows : by column, as `schemas` has them

    Raises
    ------
    InputError
        The name is no plain one.
    StoreError
        The file cannot be written.
    """
    with needing("saving an evaluation"):
        import pyarrow as pa
        import pyarrow.parquet as pq

    check_evaluation_name(name)
    types = {
        "varchar": pa.string(),
        "varchar[]": pa.list_(pa.string()),
        "timestamp": pa.timestamp("us"),
        "double": pa.float64(),
        "boolean": pa.bool_(),
    }
    schema = pa.schema([(c.name, types[c.type]) for c in TABLE_BY_NAME[FOLDER].columns])
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(list(rows), schema), sink, compression="zstd")
    folder = space / FOLDER
    path = folder / f"{name}.parquet"
    refuse_outside(space.parent, space, folder, path)
    with writing(folder):
        folder.mkdir(exist_ok=True)
        replaced = path.exists()
    write_aside(path, sink.getvalue().to_pybytes())
    return path, replaced
