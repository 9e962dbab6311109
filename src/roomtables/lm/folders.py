"""From a model's name to its files: a folder with safetensors weights, or one GGUF file.

Pickled weights, which can run code, are refused. Neither torch nor transformers is imported here.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roomtables.errors import ModelError, first_line, needing
from roomtables.limits import JSON_BYTES, json_value, read_bytes
from roomtables.lm.gguf import GgufHeader, is_gguf, read_header

EMBEDDED_MODEL = "household-lm"
EMBEDDED_FOLDER = Path(__file__).parents[1] / "models" / EMBEDDED_MODEL

HUB_TIMEOUT_SECONDS = 8
TOKENIZER_FILES = (
    "tokenizer.json",
    "tokenizer.model",
    "vocab.json",
    "vocab.txt",
    "spiece.model",
    "sentencepiece.bpe.model",
    "spm.model",
)
TOKENIZER_SETTINGS = (
    "tokenizer_config.json",
    "special_tokens_map.json",
    "added_tokens.json",
    "merges.txt",
    "bpe.codes",
)
HUB_PATTERNS = [
    "model.safetensors",
    "model-*.safetensors",
    "model.safetensors.index.json",
    "config.json",
]
_SHARD = re.compile(r"[\w-][\w.-]*\.safetensors")
PICKLES = ("pytorch_model*.bin", "*.pt", "*.pth", "*.ckpt")


@dataclass(frozen=True)
class ModelFolder:
    """A model on disk.

    Attributes
    ----------
    name : safe in a file's name
    path : the folder, or the GGUF file
    config : ``config.json`` parsed; empty for a GGUF file
    commit : of a hub model
    gguf : what a GGUF file says of itself; ``None`` for a folder
    """

    name: str
    path: Path
    config: dict[str, Any]
    commit: str | None = None
    gguf: GgufHeader | None = None

    @property
    def model_type(self) -> str:
        """What transformers calls the architecture's family; empty where nothing is said."""
        found = self.config.get("model_type")
        return found if isinstance(found, str) else ""

    @property
    def architecture(self) -> str:
        """The class that the model was saved from; empty where nothing is said."""
        match self.config.get("architectures"):
            case [str() as first, *_]:
                return first
            case _:
                return ""

    def weight_files(self) -> list[Path]:
        """The files that make up the weights, sorted by name: safetensors, or the GGUF file.

        As for transformers, weights in one file come before those that an index lists.

        Raises
        ------
        ModelError
            The index cannot be read, or lists other than safetensors files of this folder.
        """
        if self.gguf:
            return [self.path]
        single = self.path / "model.safetensors"
        index = self.path / "model.safetensors.index.json"
        if single.is_file() or not index.is_file():
            return [file for file in [single] if file.is_file()]
        listed = _read_json(index, self.name).get("weight_map")
        shards: list[Any] = list(listed.values()) if isinstance(listed, dict) else [listed]
        for shard in shards:
            if not isinstance(shard, str) or not _SHARD.fullmatch(shard):
                raise ModelError(
                    f"{self.name}: {index} lists {str(shard)[:80]!r}; weights are read from "
                    "safetensors files in the model's own folder alone"
                )
        return [self.path / shard for shard in sorted(set(shards))]

    def tokenizer_files(self) -> list[Path]:
        """Every file that decides how text becomes tokens, sorted by name; a GGUF file's tokenizer
        is in the file itself."""
        names = sorted(TOKENIZER_FILES + TOKENIZER_SETTINGS)
        return [self.path / name for name in names if (self.path / name).is_file()]


def resolve(model: str, revision: str | None = None) -> ModelFolder:
    """Find a model's folder or GGUF file and check that nothing is missing from it.

    What is local is taken as it is; a hub name is downloaded (safetensors only), or taken from
    the hub client's cache where the network does not answer.

    Raises
    ------
    ModelError
        No such model, its folder lacks weights, a configuration, or a tokenizer, or its GGUF file
        is damaged.
    MissingExtraError
        The hub's client, or for a GGUF file package gguf, is not installed.
    """
    if not model.strip():
        raise ModelError("the model's name is empty; give --model a hub name, folder or GGUF file")
    local = EMBEDDED_FOLDER if model == EMBEDDED_MODEL else Path(model).expanduser()
    if local.is_dir():
        path, commit = Path(os.path.abspath(local)), None
        name = path.name
    elif is_gguf(local):
        path = Path(os.path.abspath(local))
        return ModelFolder(_safe(path.stem), path, {}, gguf=read_header(path))
    elif local.is_file():
        raise ModelError(f"{local} is no GGUF file; give --model its folder, or a GGUF file")
    elif model == EMBEDDED_MODEL or _is_path(model):
        raise ModelError(f"no model folder at {local}; give --model an existing folder")
    else:
        path, commit = _from_hub(model, revision)
        name = model.replace("/", "--")
    return _checked(model, _safe(name), path, commit)


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "model"


def _is_path(model: str) -> bool:
    return model.startswith((".", "/", "~")) or model.count("/") > 1 or os.sep in model[-1:]


def _checked(model: str, name: str, path: Path, commit: str | None) -> ModelFolder:
    if not (path / "config.json").is_file():
        if found := sorted(path.glob("*.gguf")):
            raise ModelError(f"{model}: a folder of GGUF files; give --model one, as {found[0]}")
        raise ModelError(
            f"{model}: no config.json in {path}; give --model a folder that save_pretrained() wrote"
        )
    folder = ModelFolder(name, path, _read_json(path / "config.json", model), commit)
    if "transformers_weights" in folder.config or (path / "adapter_config.json").exists():
        raise ModelError(
            f"{model}: {path} takes weights from elsewhere (transformers_weights, or an adapter); "
            "merge them into one model and save it with save_pretrained()"
        )
    weights = folder.weight_files()
    if not weights:
        pickled = [file.name for pattern in PICKLES for file in path.glob(pattern)]
        if pickled:
            raise _pickled(model, pickled[0])
        raise ModelError(
            f"{model}: no weights (model.safetensors) in {path}; "
            "save the model there with save_pretrained()"
        )
    for file in weights:
        if not os.path.isfile(file):  # Path.is_file raises where an index lists too long a name
            name = file.name[:80]
            raise ModelError(f"{model}: weight file {name} is missing from {path}; fetch it")
    if not any((path / name).is_file() for name in TOKENIZER_FILES):
        raise ModelError(
            f"{model}: no tokenizer in {path}; save it there with tokenizer.save_pretrained()"
        )
    return folder


def _pickled(model: str, file: str) -> ModelError:
    return ModelError(
        f"{model}: weights are pickled ({file}), which can run code, and are not loaded; convert "
        "them where you trust them: AutoModelForCausalLM.from_pretrained(…).save_pretrained(…)"
    )


def _read_json(path: Path, model: str) -> dict[str, Any]:
    try:
        content = json_value(read_bytes(path, JSON_BYTES), any_number=True)
    except (OSError, ValueError) as error:
        raise ModelError(f"{model}: cannot read {path}: {error}; fetch the model again") from error
    if not isinstance(content, dict):
        raise ModelError(f"{model}: {path} holds no JSON object; fetch the model again")
    return content


def _from_hub(model: str, revision: str | None) -> tuple[Path, str | None]:
    """The folder and commit of a hub model, downloaded, or found in the hub client's cache.

    One attempt, without a progress bar.
    """
    os.environ.setdefault("HF_HUB_DISABLE_PROGRESS_BARS", "1")
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    with needing(f"the hub model {model}"):
        import huggingface_hub
        from huggingface_hub import errors as hub_errors

    patterns = [*HUB_PATTERNS, *TOKENIZER_FILES, *TOKENIZER_SETTINGS]
    try:
        info = huggingface_hub.HfApi().model_info(
            model, revision=revision, timeout=HUB_TIMEOUT_SECONDS
        )
    except hub_errors.HFValidationError as error:
        raise ModelError(f"no folder and no hub model is named {model!r}; check --model") from error
    except (hub_errors.RepositoryNotFoundError, hub_errors.RevisionNotFoundError) as error:
        at = f" at revision {revision}" if revision else ""
        raise ModelError(f"the model hub has no {model}{at}; check --model and --revision") from (
            error
        )
    except Exception as error:  # whichever HTTP library, whatever broke: no network
        return _from_hub_cache(model, revision, patterns, error)
    files = [sibling.rfilename for sibling in info.siblings or []]
    if not {"model.safetensors", "model.safetensors.index.json"} & set(files):
        if any(file.endswith(".gguf") for file in files):
            raise ModelError(f"{model} holds GGUF files; fetch one, and give --model its path")
        pickled = [file for file in files if Path(file).match("*.bin") or Path(file).match("*.pt")]
        raise _pickled(model, (pickled or ["no model.safetensors"])[0])
    try:
        path = huggingface_hub.snapshot_download(
            model, revision=info.sha, allow_patterns=patterns, etag_timeout=HUB_TIMEOUT_SECONDS
        )
    except Exception as error:
        raise ModelError(
            f"downloading {model} from the model hub broke off ({first_line(error)}); run it again"
        ) from error
    return Path(path), info.sha


def _from_hub_cache(
    model: str, revision: str | None, patterns: list[str], why: Exception
) -> tuple[Path, str | None]:
    import huggingface_hub

    try:
        path = huggingface_hub.snapshot_download(
            model, revision=revision, allow_patterns=patterns, local_files_only=True
        )
    except Exception as error:
        raise ModelError(
            f"no folder is named {model} and the model hub does not answer ({first_line(why)}); "
            f"give --model a local folder, or {EMBEDDED_MODEL}, which is built in"
        ) from error
    return Path(path), Path(path).name
