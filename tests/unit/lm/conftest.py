"""Tiny random language models of many architectures, saved as real model folders."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import transformers
from tokenizers import Tokenizer

from roomtables.lm.scorer import using_threads

OBJECTS = ("beds", "toilets", "sinks", "towels", "ovens", "washing machines", "armchairs")
ROOMS = ("bathroom", "bedroom", "kitchen", "laundry room", "living room", "rec/game room")


def room_sentences(objects: int = 2, combinations: int = 12) -> list[str]:
    """Sentences like the ones that tables are built from: shared prefixes, many endings."""
    chosen = itertools.islice(itertools.combinations(OBJECTS, objects), combinations)
    return [
        f"A room containing {' and '.join(names)} is called a {room}."
        for names in chosen
        for room in ROOMS
    ]


_SMALL: dict[str, Any] = {
    "hidden_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 4,
    "intermediate_size": 64,
    "max_position_embeddings": 64,
}
_GROUPED = {**_SMALL, "num_key_value_heads": 2}
_GPT = {"n_embd": 32, "n_layer": 2, "n_head": 4, "n_positions": 64}
ARCHITECTURES: dict[str, tuple[str, dict[str, Any]]] = {
    "gpt2": ("gpt2", _GPT),
    "gptj": ("gptj", {**_GPT, "rotary_dim": 4}),
    "gpt_neo": (
        "gpt_neo",
        {
            "hidden_size": 32,
            "num_layers": 2,
            "num_heads": 4,
            "attention_types": [[["global", "local"], 1]],
            "window_size": 40,
            "max_position_embeddings": 64,
        },
    ),
    "gpt_neox": ("gpt_neox", _SMALL),
    "llama": ("llama", _GROUPED),
    "mistral": ("mistral", {**_GROUPED, "sliding_window": 32}),
    "qwen2": ("qwen2", _GROUPED),
    "qwen3": ("qwen3", {**_GROUPED, "head_dim": 8}),
    "gemma2": ("gemma2", {**_GROUPED, "head_dim": 8, "sliding_window": 32}),
    "gemma3_text": ("gemma3_text", {**_GROUPED, "head_dim": 8, "sliding_window": 32}),
    "phi3": ("phi3", {**_GROUPED, "sliding_window": None}),
    "opt": (
        "opt",
        {
            "hidden_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 4,
            "ffn_dim": 64,
            "word_embed_proj_dim": 32,
            "max_position_embeddings": 64,
        },
    ),
    "falcon": ("falcon", {**_SMALL, "alibi": False}),
    "falcon_alibi": ("falcon", {**_SMALL, "alibi": True}),
    "bloom": ("bloom", {"hidden_size": 32, "n_layer": 2, "n_head": 4}),
    "mpt": ("mpt", {"d_model": 32, "n_layers": 2, "n_heads": 4, "max_seq_len": 64}),
    "openai-gpt": ("openai-gpt", _GPT),
    "mamba": ("mamba", {"hidden_size": 32, "num_hidden_layers": 2, "state_size": 4}),
    "bert": ("bert", _SMALL),
    "roberta": ("roberta", {**_SMALL, "max_position_embeddings": 66}),
    "modernbert": (
        "modernbert",
        {**_SMALL, "local_attention": 16, "global_attn_every_n_layers": 2},
    ),
}
MASKED = ("bert", "roberta", "modernbert")
CAUSAL = tuple(name for name in ARCHITECTURES if name not in MASKED)


def byte_level_tokenizer() -> Any:
    """Byte-level BPE without a pad token or BOS, like GPT-2's."""
    return transformers.PreTrainedTokenizerFast(
        tokenizer_object=Tokenizer.from_str(_byte_level()), eos_token="<|endoftext|>"
    )


@functools.cache  # training breaks ties at random: once a session
def _byte_level() -> str:
    from tokenizers import decoders, models, pre_tokenizers, trainers

    bare = Tokenizer(models.BPE())
    bare.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    bare.decoder = decoders.ByteLevel()
    bare.train_from_iterator(
        room_sentences(),
        trainers.BpeTrainer(
            vocab_size=330,
            special_tokens=["<|endoftext|>"],
            initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
            show_progress=False,
        ),
    )
    return str(bare.to_str())


def word_piece_tokenizer() -> Any:
    """WordPiece between [CLS] and [SEP], like BERT's, with words of several pieces."""
    return transformers.PreTrainedTokenizerFast(
        tokenizer_object=Tokenizer.from_str(_word_piece()),
        pad_token="[PAD]",
        unk_token="[UNK]",
        cls_token="[CLS]",
        sep_token="[SEP]",
        mask_token="[MASK]",
    )


@functools.cache
def _word_piece() -> str:
    from tokenizers import models, pre_tokenizers, processors, trainers

    special = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"]
    bare = Tokenizer(models.WordPiece(unk_token="[UNK]"))
    bare.pre_tokenizer = pre_tokenizers.BertPreTokenizer()
    bare.train_from_iterator(
        room_sentences(),
        trainers.WordPieceTrainer(vocab_size=90, special_tokens=special, show_progress=False),
    )
    bare.post_processor = processors.TemplateProcessing(
        single="[CLS] $A [SEP]", special_tokens=[("[CLS]", 2), ("[SEP]", 3)]
    )
    return str(bare.to_str())


def save_model(
    architecture: str, folder: Path, tokenizer: Any = None, vocabulary: int = 0, **changes: Any
) -> Path:
    """A model folder of ``architecture`` with random weights large enough to tell tokens apart."""
    masked = architecture in MASKED
    tokenizer = tokenizer or (word_piece_tokenizer() if masked else byte_level_tokenizer())
    model_type, settings = ARCHITECTURES[architecture]
    config = transformers.AutoConfig.for_model(
        model_type,
        **{
            **settings,
            "vocab_size": vocabulary or len(tokenizer),
            "pad_token_id": tokenizer.pad_token_id or 0,
            "bos_token_id": tokenizer.bos_token_id or 0,
            "eos_token_id": tokenizer.eos_token_id or 0,
            **changes,
        },
    )
    torch.manual_seed(0)
    auto = transformers.AutoModelForMaskedLM if masked else transformers.AutoModelForCausalLM
    model = auto.from_config(config)
    with torch.no_grad():
        for name, weight in model.named_parameters():
            if weight.dim() > 1 and "A_log" not in name:
                weight.mul_(4)
    model.save_pretrained(folder)
    tokenizer.save_pretrained(folder)
    return folder


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> Iterator[None]:
    """Products of tiny models are shorter than the wait for a second thread of a busy machine."""
    with using_threads(1):
        yield


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Path of a tiny model of the architecture asked for, made once a session."""
    made: dict[str, Path] = {}

    def make(architecture: str) -> Path:
        if architecture not in made:
            folder = tmp_path_factory.mktemp("models") / architecture
            made[architecture] = save_model(architecture, folder)
        return made[architecture]

    return make


@pytest.fixture(autouse=True)
def _private_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: Any) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
