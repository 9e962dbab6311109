"""What a build costs beside the model: all combinations of a label space, scored by a hash.

    python tests/benchmarks/table_side.py --labels nyuclass -k 3      # 33 million sentences

Cached, joined, checked and published as ever; prints seconds, peak memory and sizes.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from roomtables import build
from roomtables.storage.versions import SpaceFolder
from support import HashScorer


class Forgetful(HashScorer):
    """Keeps no list of what it was asked, which would be the largest thing in memory."""

    def score(self, sentences):
        return [self.score_of(sentence) for sentence in sentences]

    def score_stream(self, sentences):
        return map(self.score_of, sentences)


def size(folder: Path) -> int:
    """Bytes of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--labels", default="nyuclass")
    parser.add_argument("-k", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        tables = Path(name)
        scorer = Forgetful()
        started = time.monotonic()
        build(tables=tables, labels=options.labels, scorer=scorer, k=options.k, combinations="all")
        seconds = time.monotonic() - started
        version = SpaceFolder(tables, options.labels).current()
        rows = version.manifest.combinations["proxy"]
        print(f"sentences     {version.manifest.sentences_scored:,}")
        print(f"combinations  {rows:,}")
        print(f"seconds       {seconds:.0f}")
        print(f"peak memory   {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
        print(f"score parts   {size(tables / 'scores') / 1e6:.0f} MB")
        print(f"lookup        {size(version.path / 'lookup') / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
