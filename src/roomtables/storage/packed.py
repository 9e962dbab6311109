"""What of a published version travels, and under which name: in an archive, or through a place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from roomtables.storage.manifest import FileFacts
from roomtables.storage.versions import LOOKUP, MODEL, Pointer, Version

_CONTENT = re.compile(r"(\d{6,}-\w+)-[0-9a-f]{8}")


@dataclass(frozen=True)
class Packed:
    """The files of a version that travel.

    Attributes
    ----------
    pointer : what ``CURRENT`` says of it where it arrives
    manifest : its ``manifest.json``, which names these files alone
    places : where each file lies, by its path inside the version
    files : size and hash of each
    """

    pointer: Pointer
    manifest: bytes
    places: Mapping[str, Path]
    files: Mapping[str, FileFacts]

    @classmethod
    def of(cls, version: Version, model: Path | None = None, all_files: bool = False) -> Packed:
        """What a lookup needs, or all files; and a model's folder, where there is one.

        The name ends with the manifest's hash: two builds may bear one name and hold other files,
        and where both arrive neither may write into the other.
        """
        noted = version.manifest.files
        files = {n: noted[n] for n in sorted(noted) if all_files or n.startswith(f"{LOOKUP}/")}
        places = {name: version.path / name for name in files}
        for path in sorted(model.iterdir()) if model else ():
            name = f"{MODEL}/{path.name}"
            files[name], places[name] = FileFacts.of(path), path
        manifest = replace(version.manifest, files=files).to_bytes()
        digest = sha256(manifest).hexdigest()
        found = _CONTENT.fullmatch(version.name)
        name = found[1] if found else version.name
        return cls(Pointer(f"{name}-{digest[:8]}", digest), manifest, places, files)
