"""What can go wrong, in words a user can act on: one base and few children.

A message says what is wrong, where, and which command to type next, in one line. The command line
prints it after ``error:`` and exits 1; nothing here is ever raised for a mere data row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

# The extra that brings each package (by the name it is imported as): what pyproject.toml says.
EXTRAS: Mapping[str, str] = {
    "accelerate": "gguf",
    "duckdb": "build",
    "fsspec": "remote",
    "gguf": "gguf",
    "harlequin": "ui",
    "huggingface_hub": "lm",
    "inflect": "robot",
    "matplotlib": "report",
    "onnx": "lm",
    "onnxruntime": "robot",
    "onnxscript": "lm",
    "pyarrow": "build",
    "ray": "ray",
    "safetensors": "lm",
    "spark_dsg": "scene-graphs",
    "tokenizers": "robot",
    "torch": "lm",
    "tqdm": "build",
    "transformers": "lm",
    "yaml": "scene-graphs",
    "zmq": "scene-graphs",
}


class RoomtablesError(Exception):
    """Base of every error that a user, rather than a bug, can cause."""


class InputError(RoomtablesError):
    """A file or an argument is malformed (invalid JSON, missing column, wrong type)."""


class ConfigError(RoomtablesError):
    """``build.toml`` or an option holds a value that makes no sense."""


class LabelSpaceError(RoomtablesError):
    """A label space is missing, empty, or ambiguous."""


class ModelError(RoomtablesError):
    """A language model cannot be loaded, or returned scores that are not finite."""


class StoreError(RoomtablesError):
    """Tables are missing, damaged, of another label space, or of another schema version."""


class MissingExtraError(RoomtablesError):
    """A feature needs a package that an optional extra brings."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs an extra; run `pip install 'roomtables[{extra}]'`")


@contextmanager
def needing(feature: str, extra: str | None = None) -> Iterator[None]:
    """Say in one line which extra a feature needs: around the imports of what the extra brings.

    ``extra`` is named whatever package is missing; by default the one that brings that package.

    Raises
    ------
    MissingExtraError
        A package that an extra brings is not installed. (Any other failure of an import is raised
        as it is.)
    """
    try:
        yield
    except ModuleNotFoundError as error:
        brings = EXTRAS.get((error.name or "").partition(".")[0])
        if brings is None:
            raise
        raise MissingExtraError(feature, extra or brings) from error


def first_line(error: BaseException) -> str:
    """What an exception of another package says, in one line of at most 200 characters."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return (lines or [type(error).__name__])[0][:200]
