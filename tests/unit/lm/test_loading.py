"""Models that cannot be loaded: one line that says what, where, and what to do."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from roomtables import build
from roomtables.errors import MissingExtraError, ModelError
from roomtables.lm import identify, load_scorer
from support import small_space, write_space


@pytest.fixture
def copy(model_folder: Callable[[str], Path], tmp_path: Path) -> Path:
    """A model folder that a test may damage."""
    return Path(shutil.copytree(model_folder("gpt2"), tmp_path / "copied"))


def edit_config(folder: Path, **changes: Any) -> None:
    file = folder / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def refusal(folder: Path, **options: Any) -> str:
    with pytest.raises(ModelError) as caught:
        load_scorer(str(folder), **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_no_such_folder(tmp_path: Path) -> None:
    assert "no model folder" in refusal(tmp_path / "absent")


def test_no_configuration(copy: Path) -> None:
    (copy / "config.json").unlink()
    assert "no config.json" in refusal(copy)


def test_damaged_configuration(copy: Path) -> None:
    (copy / "config.json").write_text("{")
    assert "config.json" in refusal(copy)


def test_no_tokenizer(copy: Path) -> None:
    for file in copy.glob("*tok*"):
        file.unlink()
    assert "no tokenizer" in refusal(copy)


def test_damaged_tokenizer(copy: Path) -> None:
    (copy / "tokenizer.json").write_text("{}")
    assert "tokenizer" in refusal(copy)


def test_no_weights(copy: Path) -> None:
    (copy / "model.safetensors").unlink()
    assert "no weights" in refusal(copy)


def test_truncated_weights(copy: Path) -> None:
    file = copy / "model.safetensors"
    file.write_bytes(file.read_bytes()[:1000])
    assert "cannot load" in refusal(copy)


def test_pickled_weights_are_never_read(copy: Path) -> None:
    (copy / "model.safetensors").rename(copy / "pytorch_model.bin")
    message = refusal(copy)
    assert "pickled" in message
    assert "save_pretrained" in message


@pytest.mark.parametrize(
    "shard", ["pytorch_model-00001.bin", "../weights.safetensors", "/weights.safetensors",
              "inner/weights.safetensors", "..safetensors", 7, None, ["x"]],
)  # fmt: skip
def test_an_index_lists_safetensors_files_of_the_folder_alone(copy: Path, shard: Any) -> None:
    """What it lists is there, pickled or not: it is the name that is refused."""
    whole = (copy / "model.safetensors").rename(copy / "weights.safetensors")
    shutil.copy(whole, copy.parent)
    torch.save({}, copy / "pytorch_model-00001.bin")
    index = {"metadata": {}, "weight_map": {"transformer.wte.weight": shard}}
    (copy / "model.safetensors.index.json").write_text(json.dumps(index))
    assert "safetensors files in the model's own folder" in refusal(copy)
    with pytest.raises(ModelError, match="own folder"):
        identify(str(copy))


@pytest.mark.parametrize("letters", [1, 100, 5000])
def test_an_index_lists_what_is_not_there(copy: Path, letters: int) -> None:
    (copy / "model.safetensors").unlink()
    index = {"metadata": {}, "weight_map": {"lm_head.weight": "m" * letters + ".safetensors"}}
    (copy / "model.safetensors.index.json").write_text(json.dumps(index))
    said = refusal(copy)
    assert "is missing" in said
    assert len(said) < 500


@pytest.mark.parametrize("content", ["[]", '{"weight_map": []}', "{}", "{", '{"weight_map": 5}'])
def test_an_index_that_is_none(copy: Path, content: str) -> None:
    (copy / "model.safetensors").unlink()
    (copy / "model.safetensors.index.json").write_text(content)
    assert "model.safetensors.index.json" in refusal(copy)


def test_weights_from_elsewhere(copy: Path) -> None:
    edit_config(copy, transformers_weights="../model.safetensors")
    assert "weights from elsewhere" in refusal(copy)
    edit_config(copy, transformers_weights=None)
    (copy / "adapter_config.json").write_text('{"base_model_name_or_path": "x"}')
    assert "weights from elsewhere" in refusal(copy)


@pytest.mark.parametrize(
    "change",
    [{"architectures": 5}, {"architectures": [5]}, {"architectures": {}}, {"model_type": ["gpt2"]},
     {"model_type": {"a": 1}}, {"vocab_size": "many"}, {"n_embd": None}],
)  # fmt: skip
def test_a_configuration_of_wrong_types(copy: Path, change: dict[str, Any]) -> None:
    edit_config(copy, **change)
    said = ""
    try:
        load_scorer(str(copy))
    except ModelError as error:
        said = str(error)
    assert "\n" not in said


@pytest.mark.parametrize(
    "change",
    [{"n_layer": 10**30}, {"num_hidden_layers": 10**9}, {"num_labels": 10**30}, {"n_layer": 9_000},
     {"text_config": {"num_hidden_layers": 10**30}}, {"n_embd": 2**20}, {"vocab_size": 2**40}],
    ids=str,
)  # fmt: skip
def test_a_configuration_that_asks_for_more_than_the_weights(
    copy: Path, change: dict[str, Any]
) -> None:
    edit_config(copy, **change)
    started = time.process_time()
    said = refusal(copy)
    assert "config.json asks for" in said or "mismatch" in said or "cannot load it" in said
    assert time.process_time() - started < 20


def test_a_missing_head_is_not_drawn_at_random(copy: Path) -> None:
    from safetensors.torch import load_file, save_file

    weights = load_file(copy / "model.safetensors")
    del weights["transformer.h.1.mlp.c_fc.weight"]
    save_file(weights, copy / "model.safetensors", metadata={"format": "pt"})
    assert "lack" in refusal(copy)


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_no_room_for_it(copy: Path, dtype: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where another process has taken the memory: 100 kB are left for 37,000 weights."""
    monkeypatch.setattr("roomtables.lm.weights.free", lambda: 100_000)
    said = refusal(copy, dtype=dtype)
    assert "no room for copied" in said
    assert "about 0.00015 GB of memory (0.0001 GB free)" in said


def test_nothing_is_written_where_there_is_no_room(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = write_space(tmp_path, small_space())
    monkeypatch.setattr("roomtables.lm.weights.free", lambda: 0)
    with pytest.raises(ModelError, match="no room"):
        build(tables=tmp_path / "tables", labels=str(space), model=str(copy), device="cpu")
    written = {path.name for path in (tmp_path / "tables").rglob("*") if path.is_file()}
    assert written <= {".build-lock"}


def test_unknown_architecture(copy: Path) -> None:
    edit_config(copy, model_type="oracle")
    assert "'oracle'" in refusal(copy)


def test_a_model_with_its_own_code(copy: Path) -> None:
    edit_config(copy, model_type="oracle", auto_map={"AutoModelForCausalLM": "oracle.Oracle"})
    (copy / "oracle.py").write_text("raise SystemExit('this code ran')")
    assert "its own code" in refusal(copy)


def test_a_model_that_is_no_language_model(copy: Path) -> None:
    edit_config(copy, model_type="vit", architectures=["ViTModel"])
    assert "cannot load it as a causal language model" in refusal(copy)


def test_a_tokenizer_of_another_model(copy: Path) -> None:
    tokenizer = json.loads((copy / "tokenizer.json").read_text())
    tokenizer["model"]["vocab"]["Ġcontaining"] = 99_999
    (copy / "tokenizer.json").write_text(json.dumps(tokenizer))
    scorer_or_error = refusal_of_sentence(copy, "A room containing beds is called a bedroom.")
    assert "99999" in scorer_or_error


def refusal_of_sentence(folder: Path, sentence: str) -> str:
    with pytest.raises(ModelError) as caught:
        load_scorer(str(folder)).score([sentence])
    return str(caught.value)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"dtype": "int8"}, "unknown dtype"),
        ({"device": "tpu"}, "unknown device"),
        ({"scoring": "pll"}, "no masked language model"),
        ({"scoring": "mean"}, "unknown scoring"),
        ({"token_budget": 0}, "token budget"),
    ],
)
def test_options_that_make_no_sense(
    options: dict[str, Any], says: str, model_folder: Callable[[str], Path]
) -> None:
    assert says in refusal(model_folder("gpt2"), **options)


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
def test_cuda_that_is_absent(model_folder: Callable[[str], Path]) -> None:
    folder = model_folder("gpt2")
    assert "no CUDA device" in refusal(folder, device="cuda")
    assert load_scorer(str(folder), device="auto").describe()["device"] == "cpu"


def test_causal_scoring_of_a_masked_model(model_folder: Callable[[str], Path]) -> None:
    assert "--scoring pll" in refusal(model_folder("bert"), scoring="causal")


@pytest.mark.parametrize("missing", ["torch", "transformers"])
def test_without_the_extra(
    missing: str, model_folder: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    for module in [name for name in sys.modules if name.startswith("roomtables.lm.")]:
        monkeypatch.delitem(sys.modules, module)
    with pytest.raises(MissingExtraError, match=r"roomtables\[lm\]"):
        load_scorer(str(model_folder("gpt2")))


class TestHub:
    """The hub client is replaced by one that knows a few answers; no test needs a network."""

    @pytest.fixture
    def hub(self, monkeypatch: pytest.MonkeyPatch) -> Any:
        return pytest.importorskip("huggingface_hub")

    def test_no_network_fails_fast_and_quietly(
        self, hub: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        def offline(*_: Any, timeout: float, **__: Any) -> Any:
            assert timeout < 15
            raise ConnectionError("[Errno -2] Name or service not known")

        monkeypatch.setattr(hub.HfApi, "model_info", offline)
        began = time.monotonic()
        with pytest.raises(ModelError, match="does not answer") as caught:
            load_scorer("nobody/nothing-at-all")
        assert time.monotonic() - began < 30
        assert "household-lm" in str(caught.value)
        assert capfd.readouterr().err == ""

    def test_no_network_but_cached(
        self,
        hub: Any,
        monkeypatch: pytest.MonkeyPatch,
        model_folder: Callable[[str], Path],
    ) -> None:
        folder = model_folder("gpt2")

        def offline(*_: Any, **__: Any) -> Any:
            raise ConnectionError("no route")

        def cached(*_: Any, local_files_only: bool = False, **__: Any) -> str:
            assert local_files_only
            return str(folder)

        monkeypatch.setattr(hub.HfApi, "model_info", offline)
        monkeypatch.setattr(hub, "snapshot_download", cached)
        assert identify("someone/gpt2").startswith("someone--gpt2@")

    def test_pickles_are_not_even_downloaded(
        self, hub: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Info:
            sha = "0" * 40
            siblings = (type("Sibling", (), {"rfilename": "pytorch_model.bin"}),)

        def untouched(*_: Any, **__: Any) -> str:
            raise AssertionError("downloaded")

        monkeypatch.setattr(hub.HfApi, "model_info", lambda *_, **__: Info)
        monkeypatch.setattr(hub, "snapshot_download", untouched)
        with pytest.raises(ModelError, match="pickled"):
            load_scorer("someone/old-model")

    def test_a_name_that_is_none(self) -> None:
        with pytest.raises(ModelError, match="check --model"):
            load_scorer("not a name")


def test_the_embedded_model_is_the_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "household-lm").mkdir()  # a folder of that name elsewhere does not stand in for it
    monkeypatch.chdir(tmp_path)
    assert identify().startswith("household-lm@")
    scorer = load_scorer()
    bathroom, kitchen = scorer.score(
        [f"A room containing toilets is called a {room}." for room in ("bathroom", "kitchen")]
    )
    assert scorer.strategy == "trie"
    assert bathroom.log_prob > kitchen.log_prob
