"""Judge a checkpoint by frames, and combinations of objects, that it never read.

For every held-out frame and object set, all rooms' sentences are scored; R rooms share the
sentence's beginning. The sets come from the knowledge, never from an evaluation set.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import torch
from tokenizers import Tokenizer
from transformers import PreTrainedModel

from .facts import Facts, Room
from .grammar import Frame, load_frames, render
from .scene import Scene
from .world import World, is_held_out

_SET_SIZES = (1, 1, 1, 2, 3, 4, 5)
_NEVER = 0.002  # how typical an object is of a room that does not name it


@dataclass(frozen=True)
class Judgement:
    """Means over held-out frames and object sets; ``bias_spread`` and ``nll`` in nats."""

    accuracy: float
    calibrated_accuracy: float
    nll: float
    bias_spread: float
    best_accuracy: float


def object_sets(facts: Facts, count: int, seed: int) -> list[tuple[Room, list[str]]]:
    """Draw rooms in turn, each with a set of its objects; sets of several are held out."""
    rng = random.Random(seed)
    world = World(facts)
    rooms = list(facts.rooms.values())
    rng.shuffle(rooms)
    sets = []
    for index in range(count):
        room = rooms[index % len(rooms)]
        size = min(rng.choice(_SET_SIZES), len(room.objects))
        objects = world.draw_objects(room, size, rng, skip_held_out=False)
        while size > 1 and not is_held_out(objects):
            objects = world.draw_objects(room, size, rng, skip_held_out=False)
        sets.append((room, objects))
    return sets


@torch.no_grad()
def judge(
    model: PreTrainedModel, tokenizer: Tokenizer, facts: Facts, sets: int = 40, seed: int = 5
) -> Judgement:
    """Score every held-out frame on the same object sets."""
    frames = load_frames("held_out")
    drawn = object_sets(facts, sets, seed)
    rooms = list(facts.rooms.values())
    scores = torch.stack(
        [
            torch.stack([_room_scores(model, tokenizer, facts, frame, s) for _, s in drawn])
            for frame in frames
        ]
    ).log_softmax(-1)  # (frames, sets, rooms)
    truth = torch.tensor([rooms.index(room) for room, _ in drawn])
    bias = scores.mean(1, keepdim=True)
    best = torch.tensor([_posterior(rooms, objects) for _, objects in drawn])
    return Judgement(
        accuracy=_share_right(scores, truth),
        calibrated_accuracy=_share_right(scores - bias, truth),
        nll=-scores[:, torch.arange(len(drawn)), truth].mean().item(),
        bias_spread=bias.std(-1).mean().item(),
        best_accuracy=_share_right(best[None], truth),
    )


def _share_right(scores: torch.Tensor, truth: torch.Tensor) -> float:
    return (scores.argmax(-1) == truth).float().mean().item()


def _posterior(rooms: list[Room], objects: list[str]) -> list[float]:
    """Log p(objects | room) of the generator, less a constant."""
    return [
        sum(
            math.log(room.objects.get(name, _NEVER) / sum(room.objects.values()))
            for name in objects
        )
        for room in rooms
    ]


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
