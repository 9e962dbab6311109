"""What a build of many objects costs, worked out from rates that builds measured.

    python tests/benchmarks/scale.py --objects 1200 --rate 869

Tokens per sentence, before and after sharing, are counted on samples: all sentences of a random
pair of objects with every third one, which is what lies together once sentences are sorted.
"""

from __future__ import annotations

import argparse
import random
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from roomtables.config import load_labels
from roomtables.lm import load_scorer
from roomtables.offline.engines import SHARD_SENTENCES
from roomtables.packing.sequences import sort_sequences
from roomtables.packing.trie import build_trie
from roomtables.sentences import DEFAULT_TEMPLATE, Template
from roomtables.storage.manifest import count_combinations


def tokens_per_sentence(labels: str, template: Template, samples: int) -> tuple[float, float]:
    """Mean tokens of a sentence, and inner nodes of the trie (what a model runs) per sentence."""
    space = load_labels(labels)
    backend = load_scorer().backend
    dice = random.Random(0)
    before, after = [], []
    for _ in range(samples):
        first, second, *others = dice.sample(space.objects, len(space.objects))
        sentences = [
            sentence
            for third in others
            for sentence in template.compose([first, second, third], space.predicted_rooms)
        ]
        tokens = list(backend.encode(sentences).tokens)
        sequences, _ = sort_sequences(tokens)
        before.append(sequences.lengths.mean())
        after.append(len(build_trie(sequences).token) / len(sentences))
    return float(np.mean(before)), float(np.mean(after))


def bytes_per_sentence(folder: Path) -> float:
    """What a score takes in the parts of a scorer's folder."""
    parts = list(folder.glob("part-*.parquet"))
    rows = sum(pq.read_metadata(part).num_rows for part in parts)
    return sum(part.stat().st_size for part in parts) / rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--labels", default="nyuclass", help="whose objects stand in for more")
    parser.add_argument("--template", default=DEFAULT_TEMPLATE, help="of the sentences")
    parser.add_argument("--objects", type=int, default=1200)
    parser.add_argument("-k", type=int, default=3)
    parser.add_argument("--rate", type=float, required=True, help="sentences a second, one worker")
    parser.add_argument("--parts", type=Path, help="a scores/<scorer> folder, for bytes")
    parser.add_argument("--parameters", type=float, default=1.61e6, help="of the model")
    parser.add_argument(
        "--flops", type=float, default=3e14, help="of a GPU, per second, dense bf16"
    )
    parser.add_argument("--use", type=float, default=0.1, help="share of them that is reached")
    options = parser.parse_args()
    rooms = len(load_labels(options.labels).predicted_rooms)
    combinations = count_combinations(options.objects, options.k)
    sentences = combinations * rooms
    before, after = tokens_per_sentence(options.labels, Template(options.template), 20)
    print(f"combinations          {combinations:,}")
    print(f"sentences             {sentences:,}")
    print(f"tokens a sentence     {before:.2f}, after sharing {after:.2f}")
    print(f"tokens                {sentences * before:.3g}, after sharing {sentences * after:.3g}")
    print(f"worker hours          {sentences / options.rate / 3600:,.0f} at {options.rate:,.0f}/s")
    flops = 2 * options.parameters * sentences * after
    print(f"floating point ops    {flops:.3g}")
    print(f"GPU hours             {flops / (options.flops * options.use) / 3600:.3g}")
    print(f"shards                {-(-sentences // SHARD_SENTENCES):,}")
    print(f"lookup bytes          {combinations * (8 + 4 * rooms):,}")
    if options.parts:
        each = bytes_per_sentence(options.parts)
        print(f"score bytes           {sentences * each:.3g} ({each:.2f} a sentence)")


if __name__ == "__main__":
    main()
