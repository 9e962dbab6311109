"""The inflected names of the built-in label spaces, so that a build or a robot need not inflect.

``python -m pipeline.household_lm.inflections`` writes ``src/roomtables/inflections.csv``: a row per
name of an object or a room, as `roomtables.english` inflects it. A test keeps it in step.
"""

from __future__ import annotations

import csv
import io

from roomtables.config import builtin_labels, load_labels
from roomtables.english import NOTED, Forms, inflect_anew


def inflections() -> str:
    """The file's content: name, plural, singular (empty unless the name is a plural), article."""
    spaces = [load_labels(name) for name in builtin_labels()]
    labels = [label for space in spaces for label in (*space.objects, *space.rooms)]
    names = sorted({name for label in labels for name in (label.label, *label.synonyms)})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", *Forms._fields))
    writer.writerows((name, *inflect_anew(name)) for name in names)
    return text.getvalue()


if __name__ == "__main__":
    NOTED.write_text(inflections(), encoding="utf-8")
    print(f"wrote {NOTED}")
