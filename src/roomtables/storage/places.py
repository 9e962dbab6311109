"""Places that tables travel through, by URL: a folder, a web server, or what fsspec reaches.

A place is only written to by `push`, and only read by `pull` and `build --misses-from`.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from roomtables.errors import InputError
from roomtables.storage.folder_place import FolderPlace
from roomtables.storage.fsspec_place import FsspecPlace
from roomtables.storage.place import PATIENCE, Patience, Place, shown
from roomtables.storage.web_place import WebPlace

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")


def open_place(url: str, patience: Patience = PATIENCE) -> Place:
    """The place at a URL.

    Raises
    ------
    InputError
        It is no URL, of an unknown protocol, or has a query.
    MissingExtraError
        fsspec is not installed, and the protocol needs it.
    """
    if not _URL.match(url):
        raise InputError(f"{url!r} is no URL; name a place like s3://bucket/tables or file:///mnt")
    try:
        parts = urlsplit(url)
    except ValueError as error:  # brackets around no address
        raise InputError(f"{shown(url)} is no URL: {error}") from error
    if parts.query or parts.fragment:
        raise InputError(f"{shown(url)}: a place's URL has no `?` and no `#`")
    scheme = parts.scheme.lower()
    if scheme == "file":
        path = unquote(parts.path if parts.netloc == "localhost" else parts.netloc + parts.path)
        if "\0" in path:
            raise InputError(f"{shown(url)!r} names no folder: there is a NUL in it")
        return FolderPlace(Path(path))
    if scheme in {"http", "https"}:
        return WebPlace(url, patience)
    return FsspecPlace.open(url, patience)
