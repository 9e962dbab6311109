"""What is built for others, unpacked, and the packages that it asks for: no network, no pip."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement


def hatch(source: Path, target: str, output: Path) -> Path:
    """Build ``target`` (``wheel``, ``sdist``) from a source folder; the path of what was built."""
    run = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", output],
        cwd=source, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    (built,) = output.iterdir()
    return built


def link_requirements(asking: Distribution, folder: Path) -> None:
    """Link what a distribution needs without extras, as it is installed here, into a folder."""
    for text in asking.requires or []:
        needed = Requirement(text)
        if needed.marker is not None and not needed.marker.evaluate({"extra": ""}):
            continue
        found = distribution(needed.name)
        for name in {file.parts[0] for file in found.files or []} - {"..", "__pycache__"}:
            target = folder / name
            if not target.exists():
                target.symlink_to(Path(str(found.locate_file(name))).resolve())
        link_requirements(found, folder)
