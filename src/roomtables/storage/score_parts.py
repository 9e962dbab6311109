"""Part files of the sentence scores: named after their content, never changed, checked when read.

A part that merges or cancels others says so in its own footer (``replaces``), so that one rename
both brings it in and retires them: there is no moment in which a sentence is held twice or not at
all. Retired files stay on disk until nobody reads them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from roomtables.errors import StoreError
from roomtables.limits import json_value
from roomtables.storage.aside import sync_folder
from roomtables.storage.files import listed, refuse_outside, sha256_of, writing
from roomtables.storage.refusals import refusal

PART_SCHEMA = pa.schema(
    [
        ("scorer_id", pa.string()),
        ("sentence", pa.string()),
        ("log_prob", pa.float64()),
        ("token_count", pa.int32()),
    ]
)
FOOTER_KEY = "roomtables"
_RECOVERY = "remove it and run `roomtables build` to score its sentences again"


@dataclass(frozen=True)
class Part:
    """A part file and what its footer says.

    Attributes
    ----------
    sentences : a hash of its sentences
    replaces : names of the parts that it retires
    lossy : whether it does not hold all that those held
    """

    path: Path
    rows: int
    sentences: str = ""
    replaces: frozenset[str] = frozenset()
    lossy: bool = False

    @property
    def name(self) -> str:
        return self.path.name

    @classmethod
    def read(cls, path: Path) -> Part:
        """The part at a path, from its footer alone.

        Raises
        ------
        StoreError
            It is not a readable Parquet file of sentence scores.
        """
        try:
            with path.open("rb") as file:  # pyarrow says too little of what cannot be opened
                found = pq.read_metadata(file)
            footer = json_value((found.metadata or {}).get(FOOTER_KEY.encode(), b"{}"))
            columns = [(c.name, c.type) for c in found.schema.to_arrow_schema()]
            replaces = frozenset(map(str, footer.get("replaces", ())))
            part = cls(
                path,
                found.num_rows,
                str(footer.get("sentences", "")),
                replaces,
                bool(footer.get("lossy")),
            )
        except (pa.ArrowException, OSError, ValueError, AttributeError, TypeError) as error:
            if isinstance(error, MemoryError) or getattr(error, "errno", None):
                raise refusal(error, path, "read") or error from error
            raise StoreError(f"{path} is damaged; {_RECOVERY}") from error
        if columns != [(c.name, c.type) for c in PART_SCHEMA]:
            raise StoreError(f"{path} has other columns than sentence_scores; {_RECOVERY}")
        return part

    def verify(self) -> None:
        """Compare the content with the name.

        Raises
        ------
        StoreError
            A bit was flipped, or the file was cut or renamed.
        """
        try:
            with self.path.open("rb") as file:
                found = part_name(sha256_of(file))
        except OSError as error:
            raise refusal(error, self.path, "read") or error from error
        if found != self.name:
            raise StoreError(f"{self.path} is damaged (its content hashes to {found}); {_RECOVERY}")


def part_name(digest: str) -> str:
    """The file name of a part with this SHA-256."""
    return f"part-{digest[:16]}.parquet"


def all_parts(folder: Path) -> list[Part]:
    """Every part of one scorer's folder, by name, retired ones too.

    Raises
    ------
    StoreError
        A part is not readable, or is a symbolic link out of the tables folder.
    """
    paths = [path for path in listed(folder) if fnmatch(path.name, "part-*.parquet")]
    refuse_outside(folder.parent.parent, folder, *paths)
    return [Part.read(path) for path in paths]


def live_parts(parts: Sequence[Part]) -> list[Part]:
    """The parts that count: replaced by none, and the first by name of those with equal sentences.

    Equal sentences come about when an engine repeats a piece of work whose worker died after it had
    written its part.
    """
    replaced = {name for part in parts for name in part.replaces}
    by_sentences: dict[str, Part] = {}
    for part in parts:
        if part.name not in replaced:
            by_sentences.setdefault(part.sentences or part.name, part)
    return sorted(by_sentences.values(), key=lambda part: part.name)


def write_part(folder: Path, table: pa.Table, footer: Mapping[str, Any]) -> Path:
    """Write one part, aside and then into place; returns its path.

    Raises
    ------
    StoreError
        It cannot be written; nothing is left behind.
    """
    noted = table.replace_schema_metadata({FOOTER_KEY: json.dumps(footer, sort_keys=True)})
    sink = pa.BufferOutputStream()
    pq.write_table(noted, sink, compression="zstd")
    content = sink.getvalue()
    aside = folder / f".{os.getpid()}.tmp"
    with writing(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with aside.open("wb") as file:
                file.write(content)
            return settle(aside)
        finally:
            aside.unlink(missing_ok=True)


def settle(aside: Path) -> Path:
    """Flush a part that was written aside, and move it to the name of its content."""
    with aside.open("rb") as file:
        digest = sha256_of(file)
        os.fsync(file.fileno())
    path = aside.with_name(part_name(digest))
    os.replace(aside, path)
    sync_folder(path.parent)
    return path
