"""When a build last found the published version up to date: one line in the file ``CHECKED``.

::

    2026-11-25T02:31:07+00:00 000001-84b9ad9d

It travels with the tables: where they were pulled, it says what the machine that builds found.
"""

from __future__ import annotations

from datetime import datetime, timezone

from roomtables.limits import MalformedError, read_bytes
from roomtables.storage.files import refuse_outside, write_aside
from roomtables.storage.versions import Version

CHECKED = "CHECKED"
LINE_BYTES = 300


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
    write_aside(path, checked_line(version.name, moment))


def checked_line(name: str, moment: datetime) -> bytes:
    """What ``CHECKED`` says of the version of a name."""
    return f"{moment.isoformat(timespec='seconds')} {name}\n".encode()


def parse_checked(line: bytes, name: str) -> datetime | None:
    """When the version of a name was last found up to date, in UTC, as a line says.

    ``None`` where it says that of another version, or nothing that can be read.
    """
    try:
        moment, of = line.decode().split()
        found = datetime.fromisoformat(moment)
        return found.astimezone(timezone.utc) if of == name and found.tzinfo else None
    except (ValueError, OverflowError):
        return None


def last_checked(version: Version) -> datetime | None:
    """When a version was last found up to date, in UTC.

    ``None`` where that was never noted, or was noted of another version, or cannot be read.
    """
    path = version.path.parent / CHECKED
    try:
        if not path.is_file():  # nor a pipe, which never ends
            return None
        return parse_checked(read_bytes(path, LINE_BYTES), version.name)
    except (OSError, MalformedError):
        return None
