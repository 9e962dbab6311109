"""What input from outside may hold: limits, and the readers of JSON and YAML that keep them.

Every parser of the package reads through this module; CSV, by way of `csv_rows`. What breaks a
limit is a `MalformedError`, which says what is wrong and on which line, but not in which file: the
caller knows that, and raises an error of its own.

What the formats' own readers let through is refused here: of JSON, NaN and infinity, integers
beyond 64 bits, deep nesting and text that cannot be encoded; of YAML, merge keys, aliases that
multiply, and every tag that does not stand for a plain value.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from roomtables.errors import first_line, needing

NESTING = 100  # arrays and objects inside each other
INTEGER_DIGITS = 20  # what 64 bits hold
NAME_CHARACTERS = 10_000  # of an object, a room, or a room's id
FLOAT32_MAX = 3.4028234663852886e38  # scores are stored as 32-bit numbers
LARGEST_COUNT = 2.0**53  # what a 64-bit number counts exactly

LINE_BYTES = 16 << 20  # of JSON lines
CSV_BYTES = 256 << 20
YAML_BYTES = 512 << 10  # PyYAML takes seconds for that much
YAML_VALUES = 50_000  # with each alias counted as what it stands for
JSON_BYTES = 64 << 20  # of a document that is no scene
SCENE_BYTES = 1 << 30  # of a scene's JSON or binary graph

_LONG_NUMBER = re.compile(rf"[0-9]{{{INTEGER_DIGITS + 1}}}")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_PLAIN_TAGS = frozenset(
    f"tag:yaml.org,2002:{kind}"
    for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")
)


_TOO_DEEP = f"nested more than {NESTING} deep"


class MalformedError(ValueError):
    """Content that breaks the rules of its format or a limit; ``line`` is where, if known."""

    def __init__(self, what: str, line: int | None = None) -> None:
        super().__init__(what)
        self.line = line


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file.

    Raises
    ------
    MalformedError
        It is larger than ``most`` bytes.
    OSError
        It cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise MalformedError(f"larger than {most >> 20} MB")
    return content


def text_lines(file: BinaryIO) -> Iterator[bytes]:
    """The lines of a binary file; one that never ends is refused instead of held.

    Raises
    ------
    MalformedError
        A line is longer than ``LINE_BYTES``.
    """
    while line := file.readline(LINE_BYTES + 1):
        if len(line) > LINE_BYTES:
            raise MalformedError(f"longer than {LINE_BYTES >> 20} MB")
        yield line


def decoded(content: bytes) -> str:
    """Bytes as text.

    Raises
    ------
    MalformedError
        They are not UTF-8.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MalformedError(f"not UTF-8 text ({error.reason})") from error


def json_value(content: str | bytes, *, any_number: bool = False) -> Any:
    """The value of a JSON document. Of a key that comes twice, the last counts.

    ``any_number`` lets NaN, infinity and integers beyond 64 bits pass, as model folders hold them.

    Raises
    ------
    MalformedError
        It is no JSON, or breaks a limit.
    """
    text = decoded(content) if isinstance(content, bytes) else _checked(content)
    hooks: dict[str, Any] = {} if any_number else {"parse_constant": _refuse_constant}
    if not any_number and _LONG_NUMBER.search(text):  # seldom: a hook per integer takes time
        hooks["parse_int"] = _short_integer
    try:
        value = json.loads(text, **hooks)
    except json.JSONDecodeError as error:
        said = f"invalid JSON ({error.msg}, character {error.pos})"
        raise MalformedError(said, error.lineno) from error
    except RecursionError as error:
        raise MalformedError(_TOO_DEEP) from error
    except ValueError as error:  # of ours, or an integer of thousands of digits
        raise MalformedError(first_line(error)) from error
    if text.count("[") + text.count("{") > NESTING:
        _check_nesting(value)
    if _SURROGATE.search(text):
        _checked(json.dumps(value, ensure_ascii=False))
    return value


def _checked(text: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise MalformedError("half of a surrogate pair, which is no text") from error
    return text.removeprefix("\ufeff")


def _refuse_constant(name: str) -> None:
    raise MalformedError(f"invalid JSON ({name})")


def _short_integer(digits: str) -> int:
    if len(digits.lstrip("-")) > INTEGER_DIGITS:
        raise MalformedError(f"an integer of more than {INTEGER_DIGITS} digits")
    return int(digits)


def _check_nesting(value: Any) -> None:
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(NESTING + 1):
        if not level:
            return
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
    raise MalformedError(_TOO_DEEP)


def yaml_value(content: bytes) -> Any:
    """The value of a YAML document of plain values: text, numbers, dates, lists and mappings.

    Raises
    ------
    MalformedError
        It is no YAML, or breaks a limit.
    MissingExtraError
        PyYAML is not installed.
    """
    with needing("reading a Hydra label space"):
        import yaml

    if len(content) > YAML_BYTES:
        raise MalformedError(f"larger than {YAML_BYTES >> 10} kB")
    try:
        loader = yaml.SafeLoader(content)
        node = loader.get_single_node()
        if node is None:
            return None
        _check_yaml(loader, node, {})
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = first_line(error) if error.problem is None else error.problem[:200]
        raise MalformedError(problem, mark.line + 1 if mark else None) from error
    except yaml.YAMLError as error:
        raise MalformedError(first_line(error)) from error
    except RecursionError as error:
        raise MalformedError(_TOO_DEEP) from error


def _check_yaml(loader: Any, node: Any, sizes: dict[int, int]) -> int:
    """How many values a node stands for, aliases counted as often as they are used.

    ``sizes`` holds those of the nodes that were counted before, and 0 for those around this one.
    """
    line = node.start_mark.line + 1
    if id(node) in sizes:
        if not sizes[id(node)]:
            raise MalformedError("an alias of what it stands in", line)
        return sizes[id(node)]
    if node.tag not in _PLAIN_TAGS:
        raise MalformedError(f"{_kind(node)!r} is no plain value", line)
    sizes[id(node)] = 0
    size = 1
    if isinstance(node.value, str):
        _check_yaml_scalar(loader, node, line)
    else:
        for inner in node.value:
            for part in inner if isinstance(inner, tuple) else (inner,):
                size += _check_yaml(loader, part, sizes)
                if size > YAML_VALUES:
                    raise MalformedError(f"more than {YAML_VALUES} values, aliases counted", line)
    sizes[id(node)] = size
    return size


def _check_yaml_scalar(loader: Any, node: Any, line: int) -> None:
    if len(node.value) > NAME_CHARACTERS:
        raise MalformedError(f"a value of more than {NAME_CHARACTERS} characters", line)
    try:
        _checked(node.value)  # "\ud800" between quotes
        value = loader.construct_object(node)
    except MalformedError as error:
        raise MalformedError(str(error), line) from error
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise MalformedError(f"{node.value[:40]!r} is no {_kind(node)}", line) from error
    if isinstance(value, int) and len(f"{abs(value):x}") > 16:
        raise MalformedError("an integer beyond 64 bits", line)


def _kind(node: Any) -> str:
    """What a YAML node's tag says that it is, in a word or two."""
    return str(node.tag).rpartition(":")[2][:40]
