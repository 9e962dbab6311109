"""Judge a model by frames, and combinations of objects, that it never read.

`python -m pipeline.household_lm.judge --model FOLDER` prints the table: how far what the model says
of rooms, by whole sentences, is from the knowledge's exact posterior. For every held-out frame and
object set, all rooms' sentences are scored; they share the sentence's beginning. The sets come from
the knowledge, never from an evaluation set.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import torch
from tokenizers import Tokenizer
from transformers import AutoModelForCausalLM, PreTrainedModel

from roomtables.lm.folders import EMBEDDED_FOLDER

from .bayes import log_posterior
from .facts import Facts, Room, load_facts
from .grammar import Frame, load_frames, render
from .scene import Scene
from .world import World, is_held_out

SIZES = (1, 2, 3, 8)
_TIE = 1e-6  # nats between rooms that are equally likely


@dataclass(frozen=True)
class Judgement:
    """Means over held-out frames and sets of ``size`` objects, among all rooms.

    Attributes
    ----------
    kl : from the knowledge's exact p(room | objects) to the model's, in nats
    accuracy : share of sets whose likeliest room is the knowledge's, or one of its likeliest
    bias_spread : standard deviation over rooms of the mean log probability, in nats
    log_error : root mean square, over all rooms alike, of the model's log p(room | objects) less
        the knowledge's, in nats: what rule `pooled` adds up
    """

    size: int
    kl: float
    accuracy: float
    bias_spread: float
    log_error: float


def object_sets(facts: Facts, size: int, count: int, seed: int) -> list[list[str]]:
    """Draw sets of objects: single ones of all alike, several of one room, held out of training."""
    rng = random.Random(seed)
    world = World(facts)
    if size == 1:
        return [[thing.name] for thing in rng.choices(world.placed, k=count)]
    rooms = [room for room in facts.rooms.values() if len(room.objects) > size]
    return [_held_out(world, rng.choice(rooms), size, rng) for _ in range(count)]


def _held_out(world: World, room: Room, size: int, rng: random.Random) -> list[str]:
    objects = world.draw_objects(room, size, rng, skip_held_out=False)
    while not is_held_out(objects):
        objects = world.draw_objects(room, size, rng, skip_held_out=False)
    return objects


@torch.no_grad()
def judge(
    model: PreTrainedModel,
    tokenizer: Tokenizer,
    facts: Facts,
    sets: int,
    sizes: Sequence[int] = SIZES,
    seed: int = 5,
) -> list[Judgement]:
    """Score every held-out frame on the same object sets, so many of each size."""
    frames = load_frames("held_out")
    found = []
    for size in sizes:
        drawn = object_sets(facts, size, sets, seed)
        exact = torch.from_numpy(log_posterior(facts, drawn)).float()
        scores = torch.stack(
            [
                torch.stack([_room_scores(model, tokenizer, facts, frame, s) for s in drawn])
                for frame in frames
            ]
        ).log_softmax(-1)  # (frames, sets, rooms)
        likeliest = (exact > exact.max(-1, keepdim=True).values - _TIE).expand_as(scores)
        right = likeliest.gather(-1, scores.argmax(-1, keepdim=True))
        found.append(
            Judgement(
                size,
                (exact.exp() * (exact - scores)).sum(-1).mean().item(),
                right.float().mean().item(),
                scores.mean(1).std(-1).mean().item(),
                (scores - exact).square().mean().sqrt().item(),
            )
        )
    return found


def _room_scores(
    model: PreTrainedModel, tokenizer: Tokenizer, facts: Facts, frame: Frame, objects: list[str]
) -> torch.Tensor:
    """Log probability of a frame's sentence with each room, less their common beginning's."""
    world, texts = World(facts), []
    for room in facts.rooms.values():
        scene = Scene(world, random.Random(0), (room.name, room))
        scene.objects = objects
        texts.append(render(frame, scene.fill, random.Random(0)))
    encoded = [encoding.ids for encoding in tokenizer.encode_batch(texts)]
    shared = next(
        at for at, column in enumerate(zip(*encoded, strict=False)) if len(set(column)) > 1
    )
    return _tree_scores(model, encoded[0][:shared], [ids[shared:] for ids in encoded])


def _tree_scores(
    model: PreTrainedModel, prefix: list[int], suffixes: list[list[int]]
) -> torch.Tensor:
    """Sum the log probabilities of each suffix after one prefix, in a single row."""
    ids = prefix + [token for suffix in suffixes for token in suffix]
    positions = list(range(len(prefix)))
    branch = [-1] * len(prefix)
    before = [-1, *range(len(prefix) - 1)]
    for number, suffix in enumerate(suffixes):
        for depth in range(len(suffix)):
            before.append(len(before) - 1 if depth else len(prefix) - 1)
            positions.append(len(prefix) + depth)
            branch.append(number)
    group = torch.tensor(branch)
    seen = torch.ones(len(ids), len(ids)).tril().bool() & (
        (group[:, None] == group[None]) | (group[None] == -1)
    )
    mask = torch.where(seen, 0.0, torch.finfo(torch.float32).min)[None, None]
    row = torch.tensor([ids])
    logits = model(
        input_ids=row, position_ids=torch.tensor([positions]), attention_mask=mask, use_cache=False
    ).logits[0]
    own = logits.log_softmax(-1)[torch.tensor(before), row[0]][len(prefix) :]
    return torch.zeros(len(suffixes)).index_add(0, group[len(prefix) :], own)


@click.command()
@click.option("--model", type=click.Path(path_type=Path), default=EMBEDDED_FOLDER)
@click.option("--sets", default=40, show_default=True, help="Object sets of each size.")
def main(model: Path, sets: int) -> None:
    """Print how far a model is from the knowledge, in frames that it never read."""
    torch.set_num_threads(1)
    loaded: Any = AutoModelForCausalLM.from_pretrained(model, dtype=torch.float32)
    tokenizer = Tokenizer.from_file(str(model / "tokenizer.json"))
    click.echo("objects  KL (nats)  likeliest room  spread of bias (nats)  log error (nats)")
    for found in judge(loaded.eval(), tokenizer, load_facts(), sets):
        click.echo(
            f"{found.size:7}  {found.kl:9.3f}  {found.accuracy:14.1%}  {found.bias_spread:21.2f}"
            f"  {found.log_error:16.2f}"
        )


if __name__ == "__main__":
    main()
