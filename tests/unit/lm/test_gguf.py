"""A GGUF file scores as the model that it was made from, or is refused in one line."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tarfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("gguf", reason="needs the extra `gguf`")

from roomtables import RoomTables, build
from roomtables.cli import main
from roomtables.errors import MissingExtraError, ModelError
from roomtables.lm import identify, identities, load_scorer
from roomtables.lm.gguf import TOKEN_TYPES, TOKENS, read_header
from roomtables.lm.gguf_tokenizer import PROBES, Vocabulary, disagreement
from roomtables.onnx_lm import MODEL_FILE, OnnxScorer
from support import small_space, write_space
from unit.lm.conftest import byte_level_tokenizer, room_sentences, save_model
from unit.lm.gguf_files import write_gguf
from unit.lm.naive import causal_scores

SENTENCES = room_sentences(2, 6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_model("llama", tmp_path_factory.mktemp("llama"), tie_word_embeddings=False)


@pytest.fixture(scope="module")
def whole(folder: Path) -> bytes:
    """The bytes of a GGUF file."""
    return write_gguf(folder, folder.parent / "whole.gguf").read_bytes()


@pytest.fixture
def file(whole: bytes, tmp_path: Path) -> Path:
    """A GGUF file that a test may damage."""
    path = tmp_path / "tiny model.gguf"
    path.write_bytes(whole)
    return path


def refusal(model: Path, ask: Callable[..., Any] = load_scorer) -> str:
    with pytest.raises(ModelError) as caught:
        ask(str(model))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("quantised", [False, True])
def test_scores_as_the_folder_that_it_was_made_from(quantised: bool, tmp_path: Path) -> None:
    made = save_model("llama", tmp_path / "llama", tie_word_embeddings=not quantised)
    file = write_gguf(made, tmp_path / "tiny.gguf", quantised=quantised)
    scorer = load_scorer(str(file))
    assert scorer.strategy == "trie"
    scores, expected = scorer.score(SENTENCES), causal_scores(made, SENTENCES)
    assert [score.token_count for score in scores] == [count for _, count in expected]
    found = [score.log_prob for score in scores]
    np.testing.assert_allclose(found, [nats for nats, _ in expected], atol=1e-3, rtol=0)
    assert scorer.describe()["quantisation"] == ("Q8_0" if quantised else "F32")


def test_is_named_by_its_stem_and_by_every_byte(file: Path, whole: bytes) -> None:
    before = identify(str(file))
    assert before.startswith("tiny-model@")
    assert load_scorer(str(file)).scorer_id == before
    assert before in identities(str(file))
    assert identify(str(file), dtype="float64") != before
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert identify(str(file)) != before


def test_is_identified_without_torch(file: Path) -> None:
    code = (
        "import sys; from roomtables.lm import identify; identify(sys.argv[1]); "
        "assert not {'torch', 'transformers'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(file)], check=True)


def test_what_lies_beside_the_file_is_not_read(file: Path) -> None:
    expected = load_scorer(str(file)).score(SENTENCES)
    for name in ("config.json", "tokenizer_config.json", "adapter_config.json", "tokenizer.json"):
        (file.parent / name).write_text("{")
    assert load_scorer(str(file)).score(SENTENCES) == expected


def test_tables_are_built_with_it_and_packed_in_onnx(file: Path, tmp_path: Path) -> None:
    space = write_space(tmp_path, small_space())
    report = build(tables=tmp_path / "tables", labels=str(space), model=str(file), device="cpu")
    assert report.sentences_scored
    tables = RoomTables.open(tmp_path / "tables", labels="small")
    assert tables.classify(["toilet", "sink"]).answered_by == "table"
    packed = ["--labels", "small", "--with-model", "-o", str(tmp_path / "robot.tar.gz")]
    ran = CliRunner().invoke(main, ["export", "--tables", str(tmp_path / "tables"), *packed])
    assert ran.exit_code == 0, ran.output
    with tarfile.open(tmp_path / "robot.tar.gz") as archive:
        archive.extractall(tmp_path / "robot", filter="data")
    (onnx,) = (tmp_path / "robot").rglob(MODEL_FILE)
    made = OnnxScorer.open(onnx)
    assert made.facts.scorer_ids == identities(str(file))
    found = [score.log_prob for score in made.score(SENTENCES)]
    expected = [score.log_prob for score in load_scorer(str(file)).score(SENTENCES)]
    np.testing.assert_allclose(found, expected, atol=1e-3, rtol=0)


def count_at(whole: bytes, key: str) -> int:
    """Where the count of the list under a key stands."""
    name = key.encode()
    return whole.index(struct.pack("<Q", len(name)) + name) + 8 + len(name) + 4 + 4


DAMAGES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda whole: b"", "no GGUF file"),
    "other magic": (lambda whole: b"GGML" + whole[4:], "no GGUF file"),
    "version 1": (lambda whole: whole[:4] + struct.pack("<I", 1) + whole[8:], "of version 1"),
    "big-endian": (lambda whole: whole[:4] + struct.pack(">I", 3) + whole[8:], "byte order"),
    "header cut": (lambda whole: whole[:3000], "cut short"),
    "values cut": (lambda whole: whole[:-1000], "cut short"),
    "tensors": (lambda whole: whole[:8] + struct.pack("<Q", 2**60) + whole[16:], "announces"),
    "keys": (lambda whole: whole[:16] + struct.pack("<Q", 2**60) + whole[24:], "announces"),
    "a long key": (lambda whole: whole[:24] + struct.pack("<Q", 2**62) + whole[32:], "cut short"),
    "no text": (lambda whole: whole.replace(b"general.name", b"general.nam\xff"), "UTF-8"),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("ask", [identify, load_scorer])
def test_damaged_files(damage: str, ask: Callable[..., Any], file: Path, whole: bytes) -> None:
    change, says = DAMAGES[damage]
    file.write_bytes(change(whole))
    assert says in refusal(file, ask)


@pytest.mark.parametrize("count", [2_999_000, 2**32, 2**63])
@pytest.mark.parametrize("key", [TOKENS, TOKEN_TYPES])
def test_a_list_longer_than_the_file_takes_no_memory(
    count: int, key: str, file: Path, whole: bytes
) -> None:
    at = count_at(whole, key)
    file.write_bytes(whole[:at] + struct.pack("<Q", count) + whole[at + 8 :])
    tracemalloc.start()
    try:
        assert refusal(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20_000_000


def test_a_header_longer_than_any_is_not_read(file: Path, whole: bytes) -> None:
    with file.open("wb") as stream:
        stream.write(whole[:24] + struct.pack("<Q", 150 << 20))
        stream.truncate(200 << 20)
    assert "header is longer than 128 MB" in refusal(file, identify)


@pytest.mark.parametrize("key", ["llama.block_count", "llama.attention.head_count"])
def test_a_count_that_no_model_has(key: str, folder: Path, tmp_path: Path) -> None:
    file = write_gguf(folder, tmp_path / "tiny.gguf", changes={key: 4_000_000_000})
    assert key in refusal(file)


@pytest.mark.parametrize(
    "change",
    [{"llama.embedding_length": 1 << 20}, {"llama.feed_forward_length": 1 << 30},
     {"llama.block_count": 9_000}, {"llama.vocab_size": 4_000_000_000}],
    ids=str,
)  # fmt: skip
def test_metadata_that_ask_for_more_than_the_weights(
    change: dict[str, int], folder: Path, tmp_path: Path
) -> None:
    said = refusal(write_gguf(folder, tmp_path / "tiny.gguf", changes=change))
    assert "its metadata asks for" in said or "cannot load it" in said


def test_an_architecture_that_transformers_cannot_read(file: Path, whole: bytes) -> None:
    file.write_bytes(whole.replace(b"\x05\0\0\0\0\0\0\0llama", b"\x05\0\0\0\0\0\0\0zebra", 1))
    said = refusal(file)
    assert "cannot read a GGUF file of architecture 'zebra'" in said
    assert "safetensors" in said


def test_a_part_of_a_model(file: Path, folder: Path, tmp_path: Path) -> None:
    part = file.rename(tmp_path / "tiny-00001-of-00003.gguf")
    assert "llama-gguf-split --merge" in refusal(part)
    counted = write_gguf(folder, tmp_path / "first.gguf", changes={"split.count": 3})
    assert "llama-gguf-split --merge" in refusal(counted)


def test_no_such_file_no_gguf_file_and_a_folder_of_them(file: Path, tmp_path: Path) -> None:
    assert "check --model" in refusal(tmp_path / "absent.gguf")
    (tmp_path / "notes.txt").write_text("nothing")
    assert "no GGUF file" in refusal(tmp_path / "notes.txt")
    assert str(file) in refusal(file.parent)


def test_masked_scoring_is_refused(file: Path) -> None:
    with pytest.raises(ModelError, match="--scoring causal"):
        load_scorer(str(file), scoring="pll")


@pytest.mark.parametrize("missing", ["gguf", "accelerate"])
def test_without_the_extra(missing: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    for name in [name for name in sys.modules if name.startswith("gguf.")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(MissingExtraError, match=r"roomtables\[gguf\]"):
        load_scorer(str(file))


def test_a_bos_that_the_file_asks_for_is_put_and_not_scored(
    file: Path, folder: Path, tmp_path: Path
) -> None:
    asking = write_gguf(
        folder, tmp_path / "bos.gguf", changes={"tokenizer.ggml.add_bos_token": True}
    )
    (plain,) = load_scorer(str(file)).score(SENTENCES[:1])
    (begun,) = load_scorer(str(asking)).score(SENTENCES[:1])
    assert begun.token_count == plain.token_count + 1


def test_merges_that_are_lost(folder: Path, tmp_path: Path) -> None:
    model = json.loads((folder / "tokenizer.json").read_text())["model"]
    first = {"tokenizer.ggml.merges": [" ".join(pair) for pair in model["merges"][:2]]}
    file = write_gguf(folder, tmp_path / "tiny.gguf", changes=first)
    assert "it cuts the token 'Ġ" in refusal(file)


def test_a_pre_tokenizer_that_is_lost(tmp_path: Path) -> None:
    """Merges learnt across words, as some families do, are out of GPT-2's reach."""
    from tokenizers import pre_tokenizers, trainers

    tokenizer = byte_level_tokenizer()
    tokenizer.backend_tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(
        add_prefix_space=False, use_regex=False
    )
    trainer = trainers.BpeTrainer(
        vocab_size=330,
        special_tokens=["<|endoftext|>"],
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    tokenizer.backend_tokenizer.train_from_iterator(room_sentences(), trainer)
    folder = save_model("llama", tmp_path / "llama", tokenizer)
    said = refusal(write_gguf(folder, tmp_path / "tiny.gguf"))
    assert "its pre-tokenizer is not the file's" in said


def test_a_file_without_tokens(folder: Path, tmp_path: Path) -> None:
    file = write_gguf(folder, tmp_path / "tiny.gguf", changes={TOKENS: None})
    assert "tokenizer" in refusal(file)


@pytest.fixture
def tokenizer_and_file(file: Path) -> tuple[Any, Vocabulary]:
    vocabulary = Vocabulary.of(read_header(file, (TOKENS, TOKEN_TYPES)).metadata)
    return byte_level_tokenizer(), vocabulary


def test_a_tokenizer_agrees_with_its_own_file(tokenizer_and_file: tuple[Any, Vocabulary]) -> None:
    assert disagreement(*tokenizer_and_file) is None


def test_a_bos_against_what_the_file_says(tokenizer_and_file: tuple[Any, Vocabulary]) -> None:
    from tokenizers import processors

    tokenizer, vocabulary = tokenizer_and_file
    tokenizer.bos_token = "<|endoftext|>"
    tokenizer.backend_tokenizer.post_processor = processors.TemplateProcessing(
        single="<|endoftext|> $A", special_tokens=[("<|endoftext|>", 0)]
    )
    assert "puts a BOS first" in str(disagreement(tokenizer, vocabulary))
    asked = Vocabulary(
        vocabulary.tokens,
        vocabulary.types,
        {**vocabulary.metadata, "tokenizer.ggml.add_bos_token": True},
    )
    assert disagreement(tokenizer, asked) is None
    assert "puts no BOS first" in str(disagreement(byte_level_tokenizer(), asked))


def test_a_space_that_is_added_or_lost(tokenizer_and_file: tuple[Any, Vocabulary]) -> None:
    from tokenizers import normalizers

    tokenizer, vocabulary = tokenizer_and_file
    tokenizer.backend_tokenizer.normalizer = normalizers.Prepend(" ")
    assert "its tokens say ' A room" in str(disagreement(tokenizer, vocabulary))
    tokenizer.backend_tokenizer.normalizer = normalizers.Replace(" ", "")
    assert "its tokens say 'Aroom" in str(disagreement(tokenizer, vocabulary))


def test_text_that_becomes_unknown(tokenizer_and_file: tuple[Any, Vocabulary]) -> None:
    tokenizer, vocabulary = tokenizer_and_file
    types = [
        2 if token == "." else kind
        for token, kind in zip(vocabulary.tokens, vocabulary.types, strict=True)
    ]
    unknown = Vocabulary(vocabulary.tokens, types, vocabulary.metadata)
    assert "unknown token" in str(disagreement(tokenizer, unknown))


def sentence_piece_changes() -> dict[str, Any]:
    """A sentencepiece vocabulary with scores and bytes, without merges, like Llama 2's."""
    from tokenizers import Tokenizer, models, pre_tokenizers, trainers

    bare = Tokenizer(models.BPE())
    bare.pre_tokenizer = pre_tokenizers.Metaspace()
    alphabet = [chr(letter) for letter in range(33, 127)]
    trainer = trainers.BpeTrainer(
        vocab_size=200, initial_alphabet=[*alphabet, "▁"], show_progress=False
    )
    bare.train_from_iterator([*SENTENCES, *PROBES], trainer)
    pieces = sorted(bare.get_vocab(), key=bare.get_vocab().__getitem__)
    tokens = ["<unk>", "<s>", "</s>", *(f"<0x{byte:02X}>" for byte in range(256)), *pieces]
    return {
        "tokenizer.ggml.model": "llama",
        "tokenizer.ggml.pre": "default",
        TOKENS: tokens,
        TOKEN_TYPES: [2, 3, 3] + [6] * 256 + [1] * len(pieces),
        "tokenizer.ggml.scores": [0.0] * 259 + [-float(rank) for rank in range(len(pieces))],
        "tokenizer.ggml.merges": None,
        "tokenizer.ggml.bos_token_id": 1,
        "tokenizer.ggml.eos_token_id": 2,
        "tokenizer.ggml.unknown_token_id": 0,
        "tokenizer.ggml.add_bos_token": None,
    }


@pytest.mark.parametrize("says", [None, True])
def test_a_sentencepiece_vocabulary(says: bool | None, tmp_path: Path) -> None:
    """Without a word of it in the file, a space and a BOS come first, as for llama.cpp."""
    changes = sentence_piece_changes()
    if says is not None:
        for setting in ("add_space_prefix", "add_bos_token"):
            changes[f"tokenizer.ggml.{setting}"] = says
    folder = save_model("llama", tmp_path / "llama", vocabulary=len(changes[TOKENS]))
    file = write_gguf(folder, tmp_path / "tiny.gguf", changes=changes)
    (score,) = load_scorer(str(file)).score(["a a"])
    assert score.token_count == 2


def test_a_space_that_the_file_wants_left_out(tmp_path: Path) -> None:
    changes = sentence_piece_changes() | {"tokenizer.ggml.add_space_prefix": False}
    folder = save_model("llama", tmp_path / "llama", vocabulary=len(changes[TOKENS]))
    said = refusal(write_gguf(folder, tmp_path / "tiny.gguf", changes=changes))
    assert "its tokens say ' A room" in said
