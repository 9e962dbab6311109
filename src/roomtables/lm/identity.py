"""The ``scorer_id``: a name that changes with everything that changes a score, and nothing else.

It covers the bytes of all weights (a header alone stays equal when a weight changes), the canonical
configuration, the tokenizer, the scoring rule, compute dtype and device class. Versions, batch
sizes and the hub's commit are provenance, not identity.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from roomtables.errors import ModelError, needing
from roomtables.limits import JSON_BYTES, json_value, read_bytes
from roomtables.lm.address_space import check_address_space
from roomtables.lm.folders import EMBEDDED_MODEL, ModelFolder, resolve
from roomtables.scorer import DTYPES, SCORING_RULE_VERSION, SCORINGS
from roomtables.storage.files import sha256_of

DEVICE_CLASSES = ("cpu", "cuda")
DEVICES = (*DEVICE_CLASSES, "auto")

# Written by a library that saved the files, without any bearing on a score.
_VOLATILE = {
    "transformers_version",
    "_name_or_path",
    "name_or_path",
    "torch_dtype",
    "dtype",
    "use_cache",
    "tokenizer_file",
    "special_tokens_map_file",
    "is_local",
    "local_files_only",
}
# Model types trained to fill in masks, for configurations that name no architecture.
_MASKED_TYPES = {
    "albert",
    "bert",
    "camembert",
    "deberta",
    "deberta-v2",
    "distilbert",
    "electra",
    "ernie",
    "modernbert",
    "mpnet",
    "roberta",
    "xlm-roberta",
}


def identify(
    model: str = EMBEDDED_MODEL,
    *,
    revision: str | None = None,
    dtype: str = "float32",
    device: str = "cpu",
    scoring: str | None = None,
) -> str:
    """The ``scorer_id`` that :func:`roomtables.lm.load_scorer` would give, without loading weights.

    Raises
    ------
    ModelError
        The model cannot be found, or an argument makes no sense.
    """
    folder = resolve(model, revision)
    return scorer_id(folder, dtype, device_class(device), scoring_kind(folder, scoring))


def identities(
    model: str,
    *,
    revision: str | None = None,
    dtype: str = "float32",
    scoring: str | None = None,
) -> tuple[str, ...]:
    """The ``scorer_id`` of a model on each device class: its identity, device class aside.

    Raises
    ------
    ModelError
        The model cannot be found, or an argument makes no sense.
    """
    return on_every_device(resolve(model, revision), dtype, scoring)


def on_every_device(folder: ModelFolder, dtype: str, scoring: str | None) -> tuple[str, ...]:
    """The ``scorer_id`` of a model's folder on each of :data:`DEVICE_CLASSES`; raises as above."""
    kind = scoring_kind(folder, scoring)
    return tuple(scorer_id(folder, dtype, device, kind) for device in DEVICE_CLASSES)


def scoring_kind(folder: ModelFolder, scoring: str | None) -> str:
    """``scoring`` where it is given, else what the model's configuration says it was trained for.

    Raises
    ------
    ModelError
        The scoring is unknown, or asks of a model what its kind cannot do.
    """
    architecture, model_type = folder.architecture, folder.model_type
    masked = "MaskedLM" in architecture or (not architecture and model_type in _MASKED_TYPES)
    if scoring is None:
        return "pll" if masked else "causal"
    if scoring not in SCORINGS:
        raise ModelError(f"unknown scoring {scoring!r}; use one of {', '.join(SCORINGS)}")
    if scoring == "causal" and masked:
        raise ModelError(f"{folder.name} is a masked language model; use --scoring pll")
    if scoring != "causal" and not masked and model_type not in _MASKED_TYPES:
        raise ModelError(f"{folder.name} is no masked language model; use --scoring causal")
    return scoring


def device_class(device: str) -> str:
    """``cpu`` or ``cuda``; ``auto`` looks for a GPU.

    Raises
    ------
    ModelError
        The device is unknown, or ``cuda`` is asked for and absent.
    """
    if device not in DEVICES:
        raise ModelError(f"unknown device {device!r}; use one of {', '.join(DEVICES)}")
    if device != "cpu" and _has_driver():
        check_address_space()
        with needing("a language model on this machine's own device"):
            import torch

        if torch.cuda.is_available():
            return "cuda"
    if device == "cuda":
        raise ModelError("no CUDA device was found; use --device cpu, or --device auto")
    return "cpu"


def _has_driver() -> bool:
    """Whether torch may find a GPU. Without a driver's library (NVIDIA) or device (AMD) there is
    none to be found, which is known before torch is imported: seconds, for a build that has nothing
    to score."""
    if not sys.platform.startswith("linux") or Path("/dev/kfd").exists():
        return True
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


def scorer_id(folder: ModelFolder, dtype: str, device: str, scoring: str) -> str:
    """``<name>@<12 hexadecimal digits>``, safe as a folder's name.

    ``device`` is a device class and ``scoring`` one of ``SCORINGS``, both already resolved.

    Raises
    ------
    ModelError
        The dtype is unknown.
    """
    if dtype not in DTYPES:
        raise ModelError(f"unknown dtype {dtype!r}; use one of {', '.join(DTYPES[:3])}")
    settings = {
        "rule": SCORING_RULE_VERSION,
        "scoring": scoring,
        "dtype": dtype,
        "device": device,
        "config": _stable(folder.config),
        "weights": _hashes(folder.weight_files()),
        "tokenizer": {file.name: _content_hash(file) for file in folder.tokenizer_files()},
    }
    return f"{folder.name}@{hashlib.sha256(_canonical(settings)).hexdigest()[:12]}"


def _canonical(content: Any) -> bytes:
    return json.dumps(content, sort_keys=True, ensure_ascii=False).encode()


def _stable(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _stable(value) for key, value in content.items() if key not in _VOLATILE}
    return [_stable(item) for item in content] if isinstance(content, list) else content


def _content_hash(file: Path) -> str:
    """Hash of a tokenizer's file; JSON settings without what the saving library adds."""
    content = file.read_bytes()
    if file.suffix == ".json":
        with contextlib.suppress(ValueError):
            content = _canonical(_stable(json_value(content, any_number=True)))
    return hashlib.sha256(content).hexdigest()


def _hashes(files: list[Path]) -> dict[str, str]:
    """SHA-256 of each weight file by name, remembered by path, size, mtime and inode."""
    memo_path = _memo_path()
    memo = _read_memo(memo_path)
    known = len(memo)
    hashes = {}
    for file in files:
        stat = file.stat()
        key = f"{file.resolve()}|{stat.st_size}|{stat.st_mtime_ns}|{stat.st_ino}"
        if key not in memo:
            with file.open("rb") as stream:
                memo[key] = sha256_of(stream)
        hashes[file.name] = memo[key]
    if len(memo) > known:
        _write_memo(memo_path, memo)
    return hashes


def _memo_path() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "roomtables" / "weight_hashes.json"


def _read_memo(path: Path) -> dict[str, str]:
    try:
        memo = json_value(read_bytes(path, JSON_BYTES))
    except (OSError, ValueError):
        return {}
    return memo if isinstance(memo, dict) else {}


def _write_memo(path: Path, memo: dict[str, str]) -> None:
    """Replace the memo; where the cache cannot be written, hashing again is all that is lost."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            json.dump(memo, stream, indent=0)
        os.replace(temporary, path)
