"""Where a pulled version came from, and when: one line in the file ``ORIGIN``.

::

    2026-11-25T02:31:07+00:00 2026-11-25T09:30:12+00:00 000001-84b9ad9d-0c1d2e3f s3://bucket/tables
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
    """Where a version came from, and when, in UTC.

    Attributes
    ----------
    url : the place's, without user and password
    pulled : when the version was pulled
    asked : when the place last said that this is what it publishes
    """

    url: str
    pulled: datetime
    asked: datetime


def note_origin(version: Version, url: str, moment: datetime) -> None:
    """Note that a place publishes a version, and that this was pulled, now or before.

    Raises
    ------
    StoreError
        The file cannot be written, or is a symbolic link out of the tables folder.
    """
    space = version.path.parent
    refuse_outside(space.parent, space, space / ORIGIN)
    before = origin_of(version)
    moments = (before.pulled if before else moment, moment)
    written = " ".join(each.isoformat(timespec="seconds") for each in moments)
    line = f"{written} {version.name} {url}\n"
    write_aside(space / ORIGIN, line.encode())


def origin_of(version: Version) -> Origin | None:
    """Where a version was pulled from; ``None`` where it was built here, or that is not noted."""
    path = version.path.parent / ORIGIN
    try:
        if not path.is_file():
            return None
        *moments, name, url = read_bytes(path, _LINE_BYTES).decode().strip().split(" ", 3)
        pulled, asked = map(datetime.fromisoformat, moments)
        return Origin(url, pulled, asked) if name == version.name else None
    except (OSError, MalformedError, ValueError):
        return None
