"""The measures of a training as a CSV, and a plot of them."""

from __future__ import annotations

import csv
from pathlib import Path

_PANELS = {
    "nats per token": ("training_loss", "held_out_loss"),
    "KL to the knowledge, nats": ("kl_1", "kl_2", "kl_3", "kl_8"),
    "share right": ("accuracy_1", "accuracy_3"),
}


def append(path: Path, row: dict[str, float]) -> None:
    """Add a row to the CSV, and draw it anew."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, row)
        if new:
            writer.writeheader()
        writer.writerow({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in row.items()})
    plot(path)


def plot(path: Path) -> None:
    """Draw the CSV's losses, and what the held-out frames say, as a PNG of the same name."""
    from matplotlib.figure import Figure

    with path.open(encoding="utf-8", newline="") as lines:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(lines)]
    tokens = [row["tokens"] / 1e6 for row in rows]
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for axes, (title, keys) in zip(figure.subplots(1, 3), _PANELS.items(), strict=True):
        for key in keys:
            axes.plot(tokens, [row[key] for row in rows], marker=".", label=key.replace("_", " "))
        axes.set(title=title, xlabel="million tokens read", ylim=(0, None))
        axes.legend(fontsize=7)
    figure.savefig(path.with_suffix(".png"), dpi=110)
