"""Train household-lm from nothing: `python -m pipeline.household_lm.train`.

It may be stopped at any time; the same command goes on from the last checkpoint. At the end the
averaged weights are exported in float16 to ``--output``, and as an ONNX file for robots.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import click
import torch
from tqdm import tqdm
from transformers import PreTrainedTokenizerFast

from . import progress
from .facts import load_facts
from .onnx import write_onnx
from .packing import BOS, batches
from .training import Recipe, Training, new_model

MODEL_FOLDER = Path(__file__).parents[2] / "src" / "roomtables" / "models" / "household-lm"


def train(
    training: Training, measure_every: int, judge_sets: int = 12, stop_at: int | None = None
) -> None:
    """Train to the recipe's end (or ``stop_at``), measuring and saving on the way."""
    recipe = training.recipe
    stream = batches(
        training.posterior, recipe.seed * 1_000_000, recipe.rows, recipe.length, training.position
    )
    end = min(recipe.steps, stop_at or recipe.steps)
    tokens = recipe.batch_tokens
    bar = tqdm(
        total=recipe.steps * tokens,
        initial=training.step * tokens,
        unit="token",
        unit_scale=True,
        mininterval=2,
    )
    with bar:
        while training.step < end:
            batch, training.position = next(stream)
            loss = training.update(batch)
            bar.update(tokens)
            bar.set_postfix(loss=f"{loss:.3f}", refresh=False)
            if training.step % measure_every == 0 or training.step == end:
                training.save()
                _log(training, loss, judge_sets)


def _log(training: Training, loss: float, judge_sets: int) -> None:
    row = {
        "step": training.step,
        "tokens": training.step * training.recipe.batch_tokens,
        "cpu_seconds": round(training.cpu_seconds),
        "training_loss": loss,
        **training.measure(judge_sets),
    }
    progress.append(training.work / "progress.csv", row)
    tqdm.write(json.dumps(row))


def export(training: Training, folder: Path) -> None:
    """Write the averaged weights in float16, with configuration and tokenizer."""
    folder.mkdir(parents=True, exist_ok=True)
    model = new_model(training.recipe, training.tokenizer)
    model.load_state_dict(training.average.state_dict())
    model.half().save_pretrained(folder)
    (folder / "generation_config.json").unlink(missing_ok=True)
    PreTrainedTokenizerFast(
        tokenizer_object=training.tokenizer,
        bos_token=BOS,
        clean_up_tokenization_spaces=False,
        model_max_length=512,
    ).save_pretrained(folder)


@click.command()
@click.option("--work", type=click.Path(path_type=Path), default=Path("build/household-lm"))
@click.option("--output", type=click.Path(path_type=Path), default=MODEL_FOLDER)
@click.option("--measure-every", default=500, show_default=True, help="Steps between measures.")
@click.option("--seed", default=Recipe.seed, show_default=True)
@click.option("--tokens", default=Recipe.tokens, show_default=True)
@click.option("--vocabulary", default=Recipe.vocabulary, show_default=True)
@click.option("--width", default=Recipe.width, show_default=True)
@click.option("--layers", default=Recipe.layers, show_default=True)
@click.option("--inner", default=Recipe.inner, show_default=True)
@click.option("--heads", default=Recipe.heads, show_default=True)
@click.option("--learning-rate", default=Recipe.learning_rate, show_default=True)
@click.option("--embedding-rate", default=Recipe.embedding_rate, show_default=True)
@click.option("--weight-decay", default=Recipe.weight_decay, show_default=True)
@click.option("--answer-weight", default=Recipe.answer_weight, show_default=True)
@click.option("--evidence-weight", default=Recipe.evidence_weight, show_default=True)
@click.option("--dropout", default=Recipe.dropout, show_default=True)
@click.option("--average", default=Recipe.average, show_default=True)
def main(work: Path, output: Path, measure_every: int, **options: Any) -> None:
    """Train, or go on training, and export."""
    torch.set_num_threads(min(2, os.cpu_count() or 1))  # its matrices are too small for more
    work.mkdir(parents=True, exist_ok=True)
    training = Training(Recipe(**options), load_facts(), work)
    training.resume()
    train(training, measure_every)
    export(training, output)
    write_onnx(output)


if __name__ == "__main__":
    main()
