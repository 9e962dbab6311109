"""The names that robots and data sets use, and how much of them label space household reads.

``python -m pipeline.household_lm.name_lists`` writes the counts into ``names/README.md``.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from typing import NamedTuple

from pipeline.household_lm.label_space import ALSO

FOLDER = ALSO.parent
README = FOLDER / "README.md"
TITLES = {
    "coco": "COCO's 80 things",
    "ade20k": "ADE20K's 150 classes",
    "hydra": "Hydra's label spaces",
    "ai2thor": "AI2-THOR's object types",
    "mpcat40": "Matterport3D's mpcat40",
    "nyuclass": "Matterport3D's nyuClass",
    "lvis": "LVIS",
    "scannet200": "ScanNet200",
    "objects365": "Objects365",
    "openimages": "Open Images, indoors",
}
MISSING = "missing"
_BLOCK = re.compile(r"(<!-- lists: begin -->\n).*?(<!-- lists: end -->)", re.DOTALL)


class Entry(NamedTuple):
    """A name, the label that it is read as, and, where there is none, why."""

    name: str
    object: str
    why: str

    @property
    def is_household(self) -> bool:
        """Whether it names a household object, known or not."""
        return bool(self.object) or self.why.startswith(MISSING)


def read_list(name: str) -> list[Entry]:
    """The entries of one list, in its order."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8", newline="") as lines:
        return [Entry(row["name"], row["object"], row["why"]) for row in csv.DictReader(lines)]


class Counts(NamedTuple):
    """Of one list: its names, the household objects among them, and those that are read."""

    names: int
    household: int
    read: int

    @classmethod
    def of(cls, entries: Sequence[Entry]) -> Counts:
        household = [entry for entry in entries if entry.is_household]
        return cls(len(entries), len(household), sum(bool(entry.object) for entry in household))

    @property
    def share(self) -> float:
        """The share of the household objects that is read."""
        return self.read / self.household


def readme() -> str:
    """The README's text, with the counts as the lists have them."""
    head = "| list | names | household objects | read |\n|---|---|---|---|\n"
    rows = head + "".join(_row(title, Counts.of(read_list(name))) for name, title in TITLES.items())
    return _BLOCK.sub(rf"\g<1>{rows}\g<2>", README.read_text(encoding="utf-8"))


def _row(title: str, counts: Counts) -> str:
    read = f"{counts.read} ({counts.share:.1%})".replace("%", " %")
    return f"| {title} | {counts.names} | {counts.household} | {read} |\n"


if __name__ == "__main__":
    README.write_text(readme(), encoding="utf-8")
    print(f"wrote {README}")
