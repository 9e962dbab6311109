"""A GGUF file as transformers reads it: its configuration, weights and tokenizer.

transformers rebuilds the tokenizer from the file's lists of tokens and merges, by rules of its own
for each family, so what it makes is checked against the file before it is used.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import transformers

from roomtables.errors import MissingExtraError, ModelError, first_line
from roomtables.lm.folders import ModelFolder
from roomtables.lm.gguf import TOKEN_TYPES, TOKENS, read_header
from roomtables.lm.gguf_tokenizer import Vocabulary, disagreement

_FILE = "model.gguf"


@contextmanager
def readable(folder: ModelFolder) -> Iterator[dict[str, Any]]:
    """What ``from_pretrained`` of a model class is told to read.

    A GGUF file is read from a folder that holds nothing else: of what lies beside it (adapters,
    configurations) transformers would take note, too.

    Raises
    ------
    ModelError
        transformers cannot read GGUF files of this architecture.
    MissingExtraError
        What reads a GGUF file is not installed.
    """
    if folder.gguf is None:
        yield {"pretrained_model_name_or_path": folder.path, "use_safetensors": True}
        return
    if any(find_spec(package) is None for package in ("gguf", "accelerate")):
        raise MissingExtraError("a GGUF model", "gguf")
    with _alone(folder.path) as place, redirect_stderr(io.StringIO()):  # a progress bar
        yield {
            "pretrained_model_name_or_path": place,
            "gguf_file": _FILE,
            "config": _configuration(folder, place),
            "quantization_config": transformers.GgufConfig(dequantize=True),
        }


@contextmanager
def _alone(file: Path) -> Iterator[str]:
    with TemporaryDirectory() as place:
        (Path(place) / _FILE).symlink_to(file)
        yield place


def _configuration(folder: ModelFolder, place: str) -> Any:
    try:
        return transformers.AutoConfig.from_pretrained(
            place, gguf_file=_FILE, trust_remote_code=False, local_files_only=True
        )
    except Exception as error:  # whatever is wrong with the metadata
        architecture = folder.gguf.architecture[:40] if folder.gguf else ""
        raise ModelError(
            f"{folder.name}: transformers {transformers.__version__} cannot read a GGUF file of "
            f"architecture {architecture!r} ({first_line(error)}); give --model the model's folder "
            "with safetensors, or another model"
        ) from error


def load_gguf_tokenizer(folder: ModelFolder) -> Any:
    """The tokenizer that transformers makes of a GGUF file, once it has agreed with the file.

    Raises
    ------
    ModelError
        transformers cannot make one, or it gives other tokens than the file says.
    """
    try:
        with _alone(folder.path) as place:
            tokenizer = transformers.PreTrainedTokenizerFast.from_pretrained(
                place, gguf_file=_FILE, local_files_only=True
            )
        header = read_header(folder.path, (TOKENS, TOKEN_TYPES))
        wrong = disagreement(tokenizer, Vocabulary.of(header.metadata))
    except ModelError:
        raise
    except Exception as error:  # lists that are missing, of other kinds, or of unequal length
        wrong = first_line(error)
    if wrong:
        raise ModelError(
            f"{folder.name}: transformers {transformers.__version__} cannot rebuild its tokenizer "
            f"({wrong}); give --model the model's folder with safetensors, or another model"
        )
    return tokenizer
