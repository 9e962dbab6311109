"""The knowledge's own scores for a label space: what the embedded model would score at its best.

    python -m pipeline.household_lm.knowledge_scores mpcat40 -o scores.csv
    roomtables build --labels mpcat40 --scores scores.csv --tables knowledge

Rule `pooled` on those tables says how far a model can get by single objects that learned this
knowledge, and nothing else, without a fault.
"""

from __future__ import annotations

import csv
from pathlib import Path

import click

from roomtables.config import load_labels
from roomtables.labels import normalise

from .bayes import log_posterior
from .facts import load_facts


def knowledge_scores(labels: str) -> list[tuple[str, str, float]]:
    """Object, room and log p(room | object) in nats, over all rooms of the knowledge.

    An object that the knowledge does not know tells nothing: it scores 0 for every room. A room
    that it does not know scores as the least likely one that it does.
    """
    facts, space = load_facts(), load_labels(labels)
    things = {normalise(name): thing.name for thing in facts.things.values()
              for name, _ in thing.called()}  # fmt: skip
    columns = {normalise(name): column for column, room in enumerate(facts.rooms.values())
               for name in (room.name, *room.synonyms)}  # fmt: skip
    rows = []
    for label in space.objects:
        name = things.get(normalise(label.label))
        shares = log_posterior(facts, [[name]])[0].tolist() if name else [0.0] * len(facts.rooms)
        for room in space.rooms:
            column = columns.get(normalise(room.label))
            score = min(shares) if column is None else shares[column]
            rows.append((label.label, room.label, score))
    return rows


@click.command()
@click.argument("labels")
@click.option("-o", "--output", type=click.Path(path_type=Path), default="scores.csv")
def main(labels: str, output: Path) -> None:
    """Write the knowledge's scores for a label space, as `build --scores` reads them."""
    with output.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["object", "room", "log_prob"])
        table.writerows((o, r, f"{score:.9f}") for o, r, score in knowledge_scores(labels))
    click.echo(f"{output}: log p(room | object) of {labels} by the knowledge")


if __name__ == "__main__":
    main()
