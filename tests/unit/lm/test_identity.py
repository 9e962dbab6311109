"""A scorer's name changes with everything that changes a score, and with nothing else."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from roomtables.lm import identify, identity, load_scorer


@pytest.fixture
def folder(model_folder: Callable[[str], Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(model_folder("gpt2"), tmp_path / "my model"))


def edit(file: Path, **changes: Any) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | changes, indent=1))


def test_equals_the_loaded_scorers(folder: Path) -> None:
    name = identify(str(folder))
    assert re.fullmatch(r"my-model@[0-9a-f]{12}", name)
    assert load_scorer(str(folder)).scorer_id == name


def test_loads_no_tensors(folder: Path) -> None:
    code = (
        "import sys; from roomtables.lm import identify; identify(sys.argv[1]); "
        "assert not {'torch', 'transformers'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True)


def test_one_changed_weight_changes_it(folder: Path) -> None:
    before = identify(str(folder))
    file = folder / "model.safetensors"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    assert identify(str(folder)) != before


def test_what_changes_it(folder: Path) -> None:
    names = {identify(str(folder)), identify(str(folder), dtype="bfloat16")}
    edit(folder / "config.json", layer_norm_epsilon=1e-4)
    names.add(identify(str(folder)))
    edit(folder / "tokenizer_config.json", add_bos_token=True)
    names.add(identify(str(folder)))
    assert len(names) == 4


def test_what_does_not(folder: Path) -> None:
    before = identify(str(folder))
    edit(folder / "config.json", transformers_version="9.9", _name_or_path="/elsewhere")
    edit(folder / "tokenizer_config.json", name_or_path="/elsewhere")
    (folder / "README.md").write_text("A model.")
    (folder / "model.safetensors").touch()
    assert identify(str(folder)) == before


def test_scoring_is_part_of_it(model_folder: Callable[[str], Path]) -> None:
    bert = str(model_folder("bert"))
    assert identify(bert) == identify(bert, scoring="pll") != identify(bert, scoring="pll_word_l2r")


def test_unchanged_weights_are_hashed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = identify(str(folder))

    def unread(*_: Any) -> Any:
        raise AssertionError("hashed again")

    monkeypatch.setattr(identity, "sha256_of", unread)
    assert identify(str(folder)) == before


def test_a_damaged_or_unwritable_memo_costs_only_time(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = identify(str(folder))
    memo = tmp_path / "cache" / "roomtables" / "weight_hashes.json"
    memo.parent.mkdir(parents=True)
    memo.write_text("[nonsense")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert identify(str(folder)) == before
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "config.json"))
    assert identify(str(folder)) == before
