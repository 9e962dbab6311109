"""Where a pulled version came from, and when: one line in the file ``ORIGIN``.

::

    2026-11-25T02:31:07+00:00 000001-84b9ad9d-0c1d2e3f s3://bucket/tables
"""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

from roomtables.limits import MalformedError, read_bytes
from roomtables.storage.files import refuse_outside, write_aside
from roomtables.storage.versions import Version

ORIGIN = "ORIGIN"
_LINE_BYTES = 4000


class Origin(NamedTuple):
    """The place's URL, without user and password, and when the version was pulled, in UTC."""

    url: str
    moment: datetime


def note_origin(version: Version, url: str, moment: datetime) -> None:
    """Note where a version was pulled from.

    Raises
    ------
    StoreError
        The file cannot be written, or is a symbolic link out of the tables folder.
    """
    space = version.path.parent
    refuse_outside(space.parent, space, space / ORIGIN)
    line = f"{moment.isoformat(timespec='seconds')} {version.name} {url}\n"
    write_aside(space / ORIGIN, line.encode())


def origin_of(version: Version) -> Origin | None:
    """Where a version was pulled from; ``None`` where it was built here, or that is not noted."""
    path = version.path.parent / ORIGIN
    try:
        if not path.is_file():
            return None
        moment, name, url = read_bytes(path, _LINE_BYTES).decode().strip().split(" ", 2)
        return Origin(url, datetime.fromisoformat(moment)) if name == version.name else None
    except (OSError, MalformedError, ValueError):
        return None
