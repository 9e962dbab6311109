"""The header of a GGUF file, read within bounds before any other library reads the file.

GGUF (of llama.cpp) holds a model in one file: metadata that stand for the configuration and the
tokenizer, a table of tensors, and their values, mostly quantised. Counts and lengths in the header
are data from outside: the reader of package gguf takes memory for each entry that they announce.
Neither torch nor transformers is imported here.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

from roomtables.errors import ModelError, needing
from roomtables.limits import NAME_CHARACTERS, MalformedError

HEADER_BYTES = 128 << 20  # the largest vocabularies and their merges take some 20 MB
MOST_KEYS = 10_000
MOST_TENSORS = 100_000
MOST_ENTRIES = 3_000_000  # of all arrays: tokens, merges, scores; 1.3 million in the largest
MOST_COUNT = 10_000
"""Of layers, heads, experts, labels: ten times what the largest models have."""
MOST_ALIGNMENT = 1 << 16
MOST_DIMENSIONS = 4
TOKENS, TOKEN_TYPES = "tokenizer.ggml.tokens", "tokenizer.ggml.token_type"

_MAGIC = b"GGUF"
_VERSIONS = (2, 3)
_STRING, _ARRAY = 8, 9
_SCALARS = {0: "B", 1: "b", 2: "H", 3: "h", 4: "I", 5: "i", 6: "f", 7: "?", 10: "Q", 11: "q"}
_SCALARS[12] = "d"
_COUNT = re.compile(r".*_count(_.*)?")
_PART = re.compile(r"-\d{5}-of-\d{5}$")


@dataclass(frozen=True)
class GgufHeader:
    """What a GGUF file says of itself.

    Attributes
    ----------
    architecture : llama.cpp's name of the model's family
    metadata : all keys; an array that was not asked for is ``None``
    tensors : how many there are
    elements : how many weights they hold
    largest : weights of the largest tensor
    entries : how many values all arrays of the metadata hold
    quantisation : the number format of most weights, such as ``Q4_1``
    """

    architecture: str
    metadata: Mapping[str, Any]
    tensors: int
    elements: int
    largest: int
    entries: int
    quantisation: str


def is_gguf(path: Path) -> bool:
    """Whether a path is meant as a GGUF file: by its ending, or by how the file begins.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    if path.suffix.casefold() == ".gguf":
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def read_header(path: Path, arrays: Collection[str] = ()) -> GgufHeader:
    """The header of a GGUF file, checked against the file's size.

    Parameters
    ----------
    path : of the file
    arrays : keys whose arrays are returned; all others are only passed over

    Raises
    ------
    ModelError
        It is no GGUF file, damaged, cut short, one of several parts, or breaks a limit.
    MissingExtraError
        Package gguf is not installed.
    """
    if _PART.search(path.stem):
        raise _in_parts(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            cursor = _Cursor(file.read(min(size, HEADER_BYTES)), size)
        header = _parsed(cursor, arrays)
    except MalformedError as error:
        raise ModelError(f"{path}: {error}") from error
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}); check --model") from error
    if header.metadata.get("split.count") not in (None, 0, 1):
        raise _in_parts(path)
    return header


def _in_parts(path: Path) -> ModelError:
    return ModelError(
        f"{path} is one part of a GGUF model in several files, which transformers cannot read; "
        "join them first: llama-gguf-split --merge FIRST-PART.gguf WHOLE.gguf"
    )


class _Cursor:
    """A place in the header's bytes that never reads beyond them; ``size`` is the file's."""

    def __init__(self, content: bytes, size: int) -> None:
        self.content = content
        self.size = size
        self.position = 0
        self.entries = 0

    def skip(self, length: int) -> int:
        """Where the next ``length`` bytes begin; the place is then behind them."""
        start = self.position
        if length > len(self.content) - start:
            if len(self.content) < self.size:
                raise MalformedError(
                    f"its header is longer than {HEADER_BYTES >> 20} MB; use another --model"
                )
            raise MalformedError(
                f"cut short or damaged (of {self.size} bytes, its header asks for {length} more "
                f"at byte {start}); fetch the file again"
            )
        self.position = start + length
        return start

    def numbers(self, layout: str) -> tuple[Any, ...]:
        layout = f"<{layout}"
        return struct.unpack_from(layout, self.content, self.skip(struct.calcsize(layout)))

    def text(self) -> str:
        (length,) = self.numbers("Q")
        start = self.skip(length)
        try:
            return self.content[start : self.position].decode()
        except UnicodeDecodeError as error:
            raise _damaged(f"text at byte {start} is not UTF-8") from error

    def name(self) -> str:
        found = self.text()
        if len(found) > NAME_CHARACTERS:
            raise _damaged(f"a name of {len(found)} characters")
        return found

    def value(self, kind: int, wanted: bool) -> Any:
        """One metadata value; ``None`` for an array that is not wanted."""
        if kind == _STRING:
            return self.text()
        if kind == _ARRAY:
            return self._array(wanted)
        if kind not in _SCALARS:
            raise _damaged(f"a value of unknown kind {kind}")
        return self.numbers(_SCALARS[kind])[0]

    def _array(self, wanted: bool) -> list[Any] | None:
        kind, count = self.numbers("IQ")
        self.entries += count
        if self.entries > MOST_ENTRIES:
            raise MalformedError(
                f"its header announces lists of {self.entries} values, more than {MOST_ENTRIES}; "
                "fetch the file again"
            )
        if kind == _STRING:
            if wanted:
                return [self.text() for _ in range(count)]
            for _ in range(count):
                self.skip(*self.numbers("Q"))
            return None
        if kind not in _SCALARS:
            raise _damaged(f"a list of unknown kind {kind}")
        if wanted:
            return list(self.numbers(f"{count}{_SCALARS[kind]}"))
        self.skip(count * struct.calcsize(f"<{_SCALARS[kind]}"))
        return None


def _damaged(what: str) -> MalformedError:
    return MalformedError(f"a damaged GGUF file ({what}); fetch it again")


def _parsed(cursor: _Cursor, arrays: Collection[str]) -> GgufHeader:
    if cursor.content[: len(_MAGIC)] != _MAGIC:
        raise MalformedError(
            "no GGUF file (it does not begin with the bytes GGUF); give --model another, or fetch "
            "the file again"
        )
    cursor.skip(len(_MAGIC))
    (version,) = cursor.numbers("I")
    if version not in _VERSIONS:
        raise MalformedError(
            f"GGUF of version {version}, or of another byte order; convert the model anew with "
            "llama.cpp"
        )
    tensors, keys = cursor.numbers("QQ")
    if tensors > MOST_TENSORS or keys > MOST_KEYS:
        raise _damaged(f"it announces {tensors} tensors and {keys} keys")
    metadata = _metadata(cursor, keys, arrays)
    architecture = metadata.get("general.architecture")
    if not isinstance(architecture, str) or not architecture:
        raise _damaged("no general.architecture")
    return _with_tensors(cursor, tensors, architecture, metadata)


def _metadata(cursor: _Cursor, keys: int, arrays: Collection[str]) -> dict[str, Any]:
    metadata: dict[str, Any] = {}
    for _ in range(keys):
        key = cursor.name()
        if key in metadata:
            raise _damaged(f"key {key[:40]!r} twice")
        (kind,) = cursor.numbers("I")
        value = metadata[key] = cursor.value(kind, key in arrays)
        if _COUNT.fullmatch(key) and isinstance(value, int | float) and abs(value) > MOST_COUNT:
            raise _damaged(f"{key[:60]} is more than {MOST_COUNT}")
    return metadata


def _with_tensors(
    cursor: _Cursor, count: int, architecture: str, metadata: Mapping[str, Any]
) -> GgufHeader:
    """The whole header, once the table of tensors is read and found to lie inside the file."""
    sizes = _type_sizes()
    names: set[str] = set()
    weights: Counter[str] = Counter()
    largest = end = 0
    for _ in range(count):
        name = cursor.name()
        (dimensions,) = cursor.numbers("I")
        if name in names or dimensions > MOST_DIMENSIONS:
            raise _damaged(f"tensor {name[:40]!r} twice, or of {dimensions} dimensions")
        names.add(name)
        shape = cursor.numbers(f"{dimensions}Q")
        kind, offset = cursor.numbers("IQ")
        if kind not in sizes:
            raise MalformedError(
                f"tensor {name[:40]!r} has number format {kind}, which package gguf does not "
                "know; upgrade gguf, or use another --model"
            )
        quantisation, block, block_bytes = sizes[kind]
        elements = prod(shape)
        if elements < 1 or (shape[:1] and shape[0] % block):
            raise _damaged(f"tensor {name[:40]!r} of shape {shape}")
        weights[quantisation] += elements
        largest = max(largest, elements)
        end = max(end, offset + elements // block * block_bytes)
    if not names:
        raise MalformedError("holds no tensors, perhaps a vocabulary alone; use another --model")
    _check_end(cursor, metadata.get("general.alignment", 32), end)
    (most, _), *_ = weights.most_common(1)
    total = sum(weights.values())
    return GgufHeader(architecture, metadata, count, total, largest, cursor.entries, most)


def _check_end(cursor: _Cursor, alignment: Any, end: int) -> None:
    """Refuse tensors that end, by their offsets, behind the end of the file."""
    if type(alignment) is not int or not 0 < alignment <= MOST_ALIGNMENT:
        raise _damaged("its general.alignment")
    start = -(-cursor.position // alignment) * alignment
    if start + end > cursor.size:
        raise MalformedError(
            f"cut short: {cursor.size} bytes of {start + end}; fetch the file again"
        )


def _type_sizes() -> dict[int, tuple[str, int, int]]:
    """Of each number format: its name, the weights in a block, and the block's bytes."""
    with needing("a GGUF model"):
        from gguf.constants import GGML_QUANT_SIZES
    return {int(kind): (kind.name, *size) for kind, size in GGML_QUANT_SIZES.items()}
