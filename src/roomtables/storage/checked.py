"""When a build last found the published version up to date: one line in the file ``CHECKED``.

::

    2026-11-25T02:31:07+00:00 000001-84b9ad9d
"""

from __future__ import annotations

from datetime import datetime, timezone

from roomtables.limits import MalformedError, read_bytes
from roomtables.storage.files import refuse_outside, write_aside
from roomtables.storage.versions import Version

CHECKED = "CHECKED"
_LINE_BYTES = 300


def note_checked(version: Version, moment: datetime) -> None:
    """Note that a version was up to date at a moment.

    Raises
    ------
    StoreError
        The file cannot be written, or is a symbolic link out of the tables folder.
    """
    space = version.path.parent
    path = space / CHECKED
    refuse_outside(space.parent, space, path)
    write_aside(path, f"{moment.isoformat(timespec='seconds')} {version.name}\n".encode())


def last_checked(version: Version) -> datetime | None:
    """When a version was last found up to date, in UTC.

    ``None`` where that was never noted, or was noted of another version, or cannot be read.
    """
    path = version.path.parent / CHECKED
    try:
        if not path.is_file():  # nor a pipe, which never ends
            return None
        moment, name = read_bytes(path, _LINE_BYTES).decode().split()
        found = datetime.fromisoformat(moment)
        if name != version.name or found.tzinfo is None:
            return None
        return found.astimezone(timezone.utc)
    except (OSError, MalformedError, ValueError, OverflowError):
        return None
