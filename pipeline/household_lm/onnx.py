"""Write household-lm's ONNX file from its safetensors: `python -m pipeline.household_lm.onnx`.

`python -m pipeline.household_lm.train` ends with it, so that the two files stay in step.
"""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from roomtables.config import load_labels
from roomtables.lm import export_onnx
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.onnx_lm import MODEL_FILE
from roomtables.sentences import Template

LABELS = "mpcat40"


def sample_sentences() -> list[str]:
    """Sentences to check the file on: each object of a small label space with each room."""
    space = load_labels(LABELS)
    return [text for label in space.objects for text in Template().compose([label], space.rooms)]


def write_onnx(folder: Path) -> None:
    """Write ``model.onnx`` beside the safetensors of a model's folder."""
    with TemporaryDirectory(dir=folder) as aside:
        export_onnx(Path(aside), sample_sentences(), str(folder))
        os.replace(Path(aside) / MODEL_FILE, folder / MODEL_FILE)


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), default=EMBEDDED_FOLDER)
def main(folder: Path) -> None:
    """Write a trained model's ONNX file beside its weights."""
    write_onnx(folder)


if __name__ == "__main__":
    main()
