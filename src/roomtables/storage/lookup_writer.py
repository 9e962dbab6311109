"""Write the mapped lookup of a version: small arrays whole, scores in the chunks they come in.

Memory holds one chunk at a time, whatever the number of combinations. Needs numpy alone; the format
is described byte by byte in docs/lookup-format.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.storage.lookup import ARRAYS, INDEX, sampled_sha256
from roomtables.storage.manifest import FileFacts


class LookupSettings(NamedTuple):
    """The settings of a build that whoever looks up has to know.

    How a sentence about a combination that is not there would read and be scored, and how a room is
    decided where nothing else is said.
    """

    k: int
    template: tuple[str, ...]
    scored: str
    reduction: str
    source: str
    rule: str
    prior_weight: float
    evidence_power: float


@dataclass(frozen=True)
class ScoreChunks:
    """Keys ``[n]``, ascending throughout, and scores ``[n, R⁺]``, in chunks of any size.

    Attributes
    ----------
    rows : how many combinations there are in all
    width : |R⁺|
    chunks : pairs of keys and scores
    """

    rows: int
    width: int
    chunks: Iterable[tuple[NDArray[np.uint64], NDArray[np.float32]]]


Sources = Mapping[str, tuple[Mapping[str, NDArray[Any]], ScoreChunks]]


def write_lookup(
    folder: Path, labels: LabelSpace, settings: LookupSettings, sources: Sources
) -> None:
    """Write a lookup folder: arrays first, the index that names and hashes them last.

    ``sources`` holds, by source, the small arrays by name and the scores.

    Raises
    ------
    StoreError
        Keys do not ascend, or are not as many as announced.
    """
    folder.mkdir()
    index = settings._asdict() | {
        "objects": [[o.label, o.plural] for o in labels.objects],
        "rooms": [[r.label, r.article, r.predicted] for r in labels.rooms],
        "score_rooms": [room.label for room in labels.predicted_rooms],
        "object_aliases": labels.object_aliases,
        "room_aliases": labels.room_aliases,
        "sources": {
            source: {name: _write_array(folder, source, name, arrays[name]) for name in arrays}
            | _write_scores(folder, source, scores)
            for source, (arrays, scores) in sources.items()
        },
    }
    (folder / INDEX).write_bytes(json.dumps(index, ensure_ascii=False).encode())


def _write_scores(folder: Path, source: str, scores: ScoreChunks) -> dict[str, dict[str, Any]]:
    """Write the files of keys and scores; returns their entries of the index by array."""
    shapes = {"keys": (scores.rows,), "scores": (scores.rows, scores.width)}
    paths = {name: folder / f"{source}.{name}.npy" for name in shapes}
    with paths["keys"].open("wb") as keys, paths["scores"].open("wb") as values:
        _write_header(keys, ARRAYS["keys"][0], shapes["keys"])
        _write_header(values, ARRAYS["scores"][0], shapes["scores"])
        _append_chunks(source, scores, keys, values)
    return {name: _entry(path, scores.rows) for name, path in paths.items()}


def _append_chunks(
    source: str, scores: ScoreChunks, key_file: BinaryIO, score_file: BinaryIO
) -> None:
    rows, last = 0, -1
    for keys, values in scores.chunks:
        if len(keys) == 0:
            continue
        if int(keys[0]) <= last or not bool(np.all(keys[1:] > keys[:-1])):
            raise StoreError(
                f"query_scores of source {source} are not sorted by key; "
                "run `roomtables build --full-refresh`"
            )
        rows, last = rows + len(keys), int(keys[-1])
        key_file.write(np.ascontiguousarray(keys, dtype=ARRAYS["keys"][0]).data)
        score_file.write(np.ascontiguousarray(values, dtype=ARRAYS["scores"][0]).data)
    if rows != scores.rows:
        raise StoreError(
            f"query_scores of source {source} hold {rows} rows, not {scores.rows}; "
            "run `roomtables build --full-refresh`"
        )


def _write_header(file: BinaryIO, dtype: str, shape: tuple[int, ...]) -> None:
    np.lib.format.write_array_header_1_0(
        file, {"descr": dtype, "fortran_order": False, "shape": shape}
    )


def _write_array(folder: Path, source: str, name: str, array: NDArray[Any]) -> dict[str, Any]:
    path = folder / f"{source}.{name}.npy"
    np.save(path, np.ascontiguousarray(array, dtype=ARRAYS[name][0]), allow_pickle=False)
    return _entry(path, len(array))


def _entry(path: Path, rows: int) -> dict[str, Any]:
    """What the index says of a file."""
    facts = FileFacts.of(path)
    with path.open("rb") as file:
        sample = sampled_sha256(file, facts.bytes)
    return {"file": path.name, "rows": rows, **asdict(facts), "sample_sha256": sample}
