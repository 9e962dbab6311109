"""A scene file whose format is not known yet: its first kilobytes, and its JSON, decoded once.

A format is recognised by what stands here, and a reader of a JSON document takes
:attr:`SceneFile.document` instead of decoding the file again.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.limits import SCENE_BYTES, MalformedError, json_value, read_bytes

HEAD = 65_536  # bytes that are looked at to recognise a format
_BLANKS = " \t\r\n"  # what JSON takes for white space
_FIRST_KEY = re.compile(r'\s*\{\s*"((?:[^"\\]|\\.)*)"\s*:')
# A document that begins with one of these keys is never JSON lines, and may be larger than others.
_DOCUMENT_KEYS = frozenset(
    {
        "SPARK_DSG_header",
        "directed",
        "edges",
        "graph",
        "layer_ids",
        "layer_keys",
        "layer_names",
        "mesh",
        "mesh_edges",
        "mesh_layer_id",
        "metadata",
        "multigraph",
        "nodes",
        "rooms",
    }
)
_ROOM_KEYS = frozenset({"room_id", "objects", "room"})


@dataclass(frozen=True)
class SceneFile:
    """A file or a folder: ``head`` is its first bytes, none of a folder; ``size`` is in bytes.

    ``is_complete`` says that ``head`` is all that the file holds.
    """

    path: Path
    head: bytes = b""
    size: int = 0
    is_complete: bool = True
    is_folder: bool = False

    @classmethod
    def open(cls, path: Path) -> SceneFile:
        """The file or folder at a path.

        Raises
        ------
        InputError
            It cannot be read.
        """
        try:
            if path.is_dir():
                return cls(path, is_folder=True)
            with path.open("rb") as file:
                head = file.read(HEAD)
                return cls(path, head, path.stat().st_size, is_complete=not file.read(1))
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror}; give a scene file") from error

    @cached_property
    def text(self) -> str:
        """The head as text; bytes that are not UTF-8 become U+FFFD."""
        return self.head.decode("utf-8-sig", errors="replace")

    @property
    def first_line(self) -> str:
        """The first line, without the white space around it."""
        return self.text.lstrip("\ufeff").split("\n", 1)[0].strip()

    @property
    def is_blank(self) -> bool:
        """Whether the head holds nothing but white space."""
        return not self.text.strip()

    @cached_property
    def is_json(self) -> bool:
        """Whether the file begins as JSON does, with a brace or a bracket."""
        return self.text.lstrip().startswith(("{", "["))

    @cached_property
    def has_document_key(self) -> bool:
        """Whether the first key is one that a graph or a list of nested rooms begins with."""
        return self._first_key in _DOCUMENT_KEYS

    @cached_property
    def has_object_lines(self) -> bool:
        """Whether the first line is an object of its own, as JSON lines have it.

        Where nothing follows that line, the file may be a document as well (:attr:`document`).
        """
        if not self.is_json or self.has_document_key:
            return False
        begins_a_room = self._first_key in _ROOM_KEYS and self._json_lines[0].strip() != "{"
        return begins_a_room or self._first_object is not None

    @cached_property
    def document(self) -> Any:
        """The decoded JSON; None where the file is not JSON, or is JSON lines and more than one.

        Raises
        ------
        InputError
            It is not UTF-8, or not valid JSON: often a file that was cut short.
        """
        if not self.is_json:
            return None
        if self.has_object_lines:
            return self._first_object if self._is_one_line else None
        return self._decode()

    @cached_property
    def _first_key(self) -> str | None:
        found = _FIRST_KEY.match(self.text)
        return found[1] if found else None

    @cached_property
    def _json_lines(self) -> tuple[str, str]:
        """The first line that is not blank, and what follows it."""
        first, _, rest = self.text.strip(_BLANKS).partition("\n")
        return first, rest

    @cached_property
    def _first_object(self) -> dict[str, Any] | None:
        """The first line, decoded; None where it is not a whole JSON object."""
        line = self._json_lines[0]
        if not line.rstrip().endswith("}"):
            return None
        try:
            value = json_value(line)
        except MalformedError:
            return None
        return value if isinstance(value, dict) else None

    @property
    def _is_one_line(self) -> bool:
        """Whether the file is UTF-8 and holds nothing beside its first line."""
        try:
            self.head.decode()
        except UnicodeDecodeError:
            return False
        return self.is_complete and not self._json_lines[1]

    def _decode(self) -> Any:
        try:
            whole = self.is_complete
            return json_value(self.head if whole else read_bytes(self.path, SCENE_BYTES))
        except OSError as error:
            raise InputError(f"cannot read {self.path}: {error.strerror}") from error
        except MalformedError as error:
            where = f"{self.path}, line {error.line}" if error.line else self.path
            raise InputError(
                f"{where}: {error}; was the file cut short? save the graph again"
            ) from error
        except MemoryError as error:
            raise InputError(f"{self.path}: too large to be a scene") from error
