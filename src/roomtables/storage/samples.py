"""Whether a version's Parquet files are as they were written, told from a part of them.

``samples.json`` in a version's folder holds the size of each Parquet file and the SHA-256 of pages
sampled throughout it; its own hash is in the manifest. What an open reads: small files whole, of
large ones the samples, as of the arrays of a lookup.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roomtables.errors import StoreError
from roomtables.limits import JSON_BYTES, MalformedError, json_value, read_bytes
from roomtables.storage.files import sha256_of, write_aside
from roomtables.storage.lookup import SMALL_BYTES, sampled_sha256
from roomtables.storage.manifest import FileFacts
from roomtables.storage.refusals import refusal
from roomtables.storage.versions import Version

SAMPLES = "samples.json"


def write_samples(folder: Path) -> None:
    """Write the samples of the Parquet files in a folder beside them."""
    found = {}
    for path in sorted(folder.glob("*.parquet")):
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            found[path.name] = {"bytes": size, "sample_sha256": sampled_sha256(file, size)}
    write_aside(folder / SAMPLES, json.dumps(found, indent=2, sort_keys=True).encode())


def check_parquet(version: Version, verify: bool = False) -> None:
    """Compare a version's Parquet files with what was written: sizes and samples.

    Parameters
    ----------
    version : a published version
    verify : read and hash every byte

    Raises
    ------
    StoreError
        A file is missing, cut, swapped for another, or differs where it was looked at.
    """
    noted = {n: facts for n, facts in version.manifest.files.items() if n.endswith(".parquet")}
    samples = {} if verify else _samples(version)
    for name, facts in noted.items():
        path = version.path / name
        try:
            whole = _is_whole(path, facts, samples.get(name))
        except FileNotFoundError:
            whole = False
        except OSError as error:
            raise refusal(error, path, "read") or error from error
        if not whole:
            raise StoreError(f"{path} is damaged; run `roomtables build` to make it again")


def _is_whole(path: Path, noted: FileFacts, sample: object) -> bool:
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size != noted.bytes:
            return False
        if sample is None or noted.bytes <= SMALL_BYTES:
            return sha256_of(file) == noted.sha256
        return sampled_sha256(file, noted.bytes) == sample


def _samples(version: Version) -> Mapping[str, Any]:
    """The sampled hash of each file; empty where the version has none that can be relied on."""
    noted = version.manifest.files.get(SAMPLES)
    try:
        content = read_bytes(version.path / SAMPLES, JSON_BYTES) if noted else b""
        if not noted or hashlib.sha256(content).hexdigest() != noted.sha256:
            return {}
        return {name: row["sample_sha256"] for name, row in json_value(content).items()}
    except (OSError, MalformedError):
        return {}
