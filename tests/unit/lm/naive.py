"""The independent reference: one plain forward of transformers per sentence, in float64 sums."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
import transformers


def causal_scores(folder: Path, sentences: Sequence[str], **source: str) -> list[tuple[float, int]]:
    """``source`` may name a ``gguf_file`` of the folder."""
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder, **source)
    model = transformers.AutoModelForCausalLM.from_pretrained(folder, **source).eval()
    scores = []
    for sentence in sentences:
        ids = tokenizer(sentence)["input_ids"]
        with torch.no_grad():
            logits = model(torch.tensor([ids])).logits[0].double()
        total = 0.0
        for position in range(1, len(ids)):
            row = logits[position - 1]
            total += float(row[ids[position]] - torch.logsumexp(row, 0))
        scores.append((total, len(ids) - 1))
    return scores


def masked_scores(folder: Path, sentences: Sequence[str]) -> list[tuple[float, int]]:
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    model = transformers.AutoModelForMaskedLM.from_pretrained(folder).eval()
    scores = []
    for sentence in sentences:
        ids = tokenizer(sentence)["input_ids"]
        total = 0.0
        for position in range(1, len(ids) - 1):
            masked = list(ids)
            masked[position] = tokenizer.mask_token_id
            with torch.no_grad():
                row = model(torch.tensor([masked])).logits[0, position].double()
            total += float(row[ids[position]] - torch.logsumexp(row, 0))
        scores.append((total, len(ids) - 2))
    return scores
