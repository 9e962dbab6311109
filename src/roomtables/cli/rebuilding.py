"""The command that makes published tables again: what advice names."""

from __future__ import annotations

import shlex
from pathlib import Path

from roomtables.config import BuildConfig
from roomtables.storage.manifest import Manifest

_OPTIONS = (
    "model", "revision", "dtype", "device", "scoring", "k", "reduction", "smoothing", "counts",
    "scores", "engine", "workers",
)  # fmt: skip
_OF_A_FILE = (
    "token_budget", "template", "scored", "source", "rule", "prior_weight", "evidence_power",
)  # fmt: skip


def build_command(tables: Path, manifest: Manifest) -> str:
    """`roomtables build` with the options that these tables were built with."""
    settings, default = manifest.settings, BuildConfig()
    words = ["roomtables", "build", "--tables", str(tables), "--labels", settings.labels]
    if any(getattr(settings, name) != getattr(default, name) for name in _OF_A_FILE):
        words += ["--config", "FILE.toml"]
    for name in _OPTIONS:
        value = getattr(settings, name)
        if value != getattr(default, name):
            words += [f"-{'' if name == 'k' else '-'}{name}", str(value)]
    if Path(settings.combinations).suffix:  # a file; `all` and `misses` are what `auto` came to
        words += ["--combinations", settings.combinations]
    return shlex.join(words)
