"""One training of household-lm: its recipe, checkpoint, updates, and measures."""

from __future__ import annotations

import itertools
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import torch
from tokenizers import Tokenizer
from torch.nn.functional import cross_entropy
from transformers import LlamaConfig, LlamaForCausalLM

from .answers import Posterior
from .facts import Facts
from .judge import judge
from .muon import Muon
from .packing import BOS, Batch, batches, train_tokenizer
from .world import World

_VALIDATION_SEED = 900_000_000
_VALIDATION_BATCHES = 12


@dataclass(frozen=True)
class Recipe:
    """Everything that the weights depend on, besides the knowledge and the frames.

    ``read_share`` of the tokens that are no answer are learned as text: the output layer is a third
    of a step, and the text teaches little of rooms.
    """

    seed: int = 0
    tokens: int = 14_000_000
    vocabulary: int = 4096
    width: int = 160
    layers: int = 3
    inner: int = 448
    heads: int = 5
    rows: int = 24
    length: int = 128
    learning_rate: float = 6e-3
    embedding_rate: float = 6e-3
    weight_decay: float = 0.05
    answer_weight: float = 10.0
    evidence_weight: float = 2.0
    dropout: float = 0.0
    read_share: float = 0.5
    warmup_steps: int = 60
    average: float = 0.995

    @property
    def steps(self) -> int:
        """How many updates the tokens are enough for."""
        return max(1, self.tokens // self.batch_tokens)

    @property
    def batch_tokens(self) -> int:
        """Tokens of one update."""
        return self.rows * self.length

    def rate(self, step: int) -> float:
        """The learning rate's factor: a linear warm-up, a slow linear fall, a faster one."""
        warm, done = min(1.0, (step + 1) / self.warmup_steps), step / self.steps
        return warm * max(0.01, min(1 - 0.625 * done, 2 * (1 - done)))


class Training:
    """A model in training, with all that a checkpoint holds."""

    def __init__(self, recipe: Recipe, facts: Facts, work: Path) -> None:
        self.recipe, self.facts, self.work = recipe, facts, work
        self.checkpoint = work / "checkpoint.pt"
        self.tokenizer = _tokenizer(facts, recipe, work)
        self.posterior = Posterior(World(facts), self.tokenizer)
        found = (self.posterior.room_tokens, self.posterior.object_tokens)
        self.names = [torch.from_numpy(tokens) for tokens in found]
        torch.manual_seed(recipe.seed)
        self.model = new_model(recipe, self.tokenizer)
        self.average = new_model(recipe, self.tokenizer).requires_grad_(False).eval()
        self.average.load_state_dict(self.model.state_dict())
        self.optimizers = _optimizers(self.model, recipe)
        self.step, self.position = 0, (0, 0)
        self._spent = 0.0

    @property
    def cpu_seconds(self) -> float:
        """What the training took so far, over all processes that went on with it."""
        return self._spent + time.process_time()

    def save(self) -> None:
        """Write a checkpoint beside the old one, then replace it."""
        aside = self.checkpoint.with_suffix(".tmp")
        state = {
            "recipe": asdict(self.recipe),
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "step": self.step,
            "position": self.position,
            "random": torch.get_rng_state(),
            "cpu_seconds": self.cpu_seconds,
        }
        torch.save(state, aside)
        os.replace(aside, self.checkpoint)

    def resume(self) -> None:
        """Take up the checkpoint, where there is one.

        Raises
        ------
        click.ClickException
            It was written with another recipe.
        """
        if not self.checkpoint.exists():
            return
        state: dict[str, Any] = torch.load(self.checkpoint, weights_only=True)
        if state["recipe"] != asdict(self.recipe):
            raise click.ClickException(
                f"{self.checkpoint} was written with other options; "
                "give the same ones, or another --work folder"
            )
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        for optimizer, saved in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(saved)
        self.step, self.position = state["step"], tuple(state["position"])
        torch.set_rng_state(state["random"])
        self._spent = state["cpu_seconds"] - time.process_time()

    def update(self, batch: Batch) -> float:
        """Make one step; returns the batch's mean loss in nats per token."""
        recipe = self.recipe
        for optimizer, rate in zip(
            self.optimizers, (recipe.learning_rate, recipe.embedding_rate), strict=True
        ):
            for group in optimizer.param_groups:
                group["lr"] = rate * recipe.rate(self.step)
        self.model.train()
        loss, read = self._loss(batch)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        for optimizer in self.optimizers:
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        self.step += 1
        share = max(1 - recipe.average, 1 / self.step)
        for mean, value in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mean.lerp_(value.detach(), share)
        return read

    def _loss(self, batch: Batch) -> tuple[Any, float]:
        """Cross-entropy in nats per token, against an answer's distribution where there is one.

        Added to it, where objects or a room are told: cross-entropy between what might be named
        next, by the knowledge and by the model, both normalised over those names' first tokens.
        Second, what the text alone costs.
        """
        hidden, embedding = _hidden(self.model, batch), self.model.get_output_embeddings().weight
        targets = batch.targets().flatten()
        read = (targets >= 0) & (torch.rand(len(targets)) < self.recipe.read_share)
        places = torch.tensor([target.place - 1 for target in batch.answers], dtype=torch.long)
        read[places] = False
        plain = cross_entropy(hidden[read] @ embedding.T, targets[read])
        expected = torch.zeros(len(places), len(embedding))
        for row, target in zip(expected, batch.answers, strict=True):
            row[torch.from_numpy(target.tokens)] = torch.from_numpy(target.shares)
        answered = cross_entropy(hidden[places] @ embedding.T, expected, reduction="sum")
        told = sum(
            cross_entropy(hidden[at] @ embedding[names].T, shares, reduction="sum")
            for (at, shares), names in zip((batch.rooms, batch.objects), self.names, strict=True)
            if len(at)  # a small batch may tell nothing
        )
        weighted = self.recipe.answer_weight * answered + self.recipe.evidence_weight * told
        return plain + weighted / (targets >= 0).sum(), plain.item()

    def measure(self, judge_sets: int) -> dict[str, float]:
        """Held-out loss and held-out frames, with the averaged weights."""
        held_out = batches(
            self.posterior, _VALIDATION_SEED, self.recipe.rows, self.recipe.length, (0, 0)
        )
        with torch.no_grad():
            losses = [
                _read_loss(self.average, batch)
                for batch, _ in itertools.islice(held_out, _VALIDATION_BATCHES)
            ]
        found = judge(self.average, self.tokenizer, self.facts, judge_sets)
        return {
            "held_out_loss": sum(losses) / len(losses),
            **{f"kl_{row.size}": row.kl for row in found},
            **{f"accuracy_{row.size}": row.accuracy for row in found},
            **{f"bias_spread_{row.size}": row.bias_spread for row in found},
        }


def _tokenizer(facts: Facts, recipe: Recipe, work: Path) -> Tokenizer:
    path = work / "tokenizer.json"
    if not path.exists():
        tokenizer = train_tokenizer(facts, recipe.vocabulary)
        tokenizer.save(str(path.with_suffix(".tmp")))
        os.replace(path.with_suffix(".tmp"), path)
    return Tokenizer.from_file(str(path))


def new_model(recipe: Recipe, tokenizer: Tokenizer) -> LlamaForCausalLM:
    """Make an untrained model of the recipe's size."""
    return LlamaForCausalLM(
        LlamaConfig(
            vocab_size=tokenizer.get_vocab_size(),
            hidden_size=recipe.width,
            num_hidden_layers=recipe.layers,
            intermediate_size=recipe.inner,
            num_attention_heads=recipe.heads,
            num_key_value_heads=recipe.heads,
            max_position_embeddings=512,
            attention_dropout=recipe.dropout,
            tie_word_embeddings=True,
            bos_token_id=tokenizer.token_to_id(BOS),
            eos_token_id=None,
            pad_token_id=None,
        )
    )


def _optimizers(model: LlamaForCausalLM, recipe: Recipe) -> list[torch.optim.Optimizer]:
    """Muon for the matrices inside the layers, AdamW for the embedding and the norms."""
    inner = [value for name, value in model.named_parameters() if _is_inner(name, value)]
    rest = [value for name, value in model.named_parameters() if not _is_inner(name, value)]
    muon = Muon(inner, recipe.learning_rate, recipe.weight_decay)
    adam = torch.optim.AdamW(
        rest, lr=recipe.embedding_rate, weight_decay=0.0, betas=(0.9, 0.97), fused=True
    )
    return [muon, adam]


def _is_inner(name: str, value: torch.Tensor) -> bool:
    return value.ndim == 2 and "layers." in name


def _hidden(model: LlamaForCausalLM, batch: Batch) -> torch.Tensor:
    """The last layer's output: (tokens of the batch, width)."""
    hidden: torch.Tensor = model.model(
        input_ids=batch.ids,
        position_ids=batch.positions,
        attention_mask=batch.mask(),
        use_cache=False,
    ).last_hidden_state
    return hidden.flatten(0, 1)


def _read_loss(model: LlamaForCausalLM, batch: Batch) -> float:
    """What the batch's text costs: nats per token."""
    logits = model.get_output_embeddings()(_hidden(model, batch))
    return cross_entropy(logits, batch.targets().flatten()).item()
