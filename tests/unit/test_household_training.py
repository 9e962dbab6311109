"""Training household-lm: a training that is stopped and resumed ends as one that is not."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from pipeline.household_lm import packing  # noqa: E402
from pipeline.household_lm.answers import Posterior  # noqa: E402
from pipeline.household_lm.facts import Facts, load_facts  # noqa: E402
from pipeline.household_lm.packing import BOS, batches, train_tokenizer  # noqa: E402
from pipeline.household_lm.train import export, train  # noqa: E402
from pipeline.household_lm.training import Recipe, Training  # noqa: E402
from pipeline.household_lm.world import World  # noqa: E402

RECIPE = Recipe(
    tokens=6 * 4 * 64,
    vocabulary=400,
    width=32,
    layers=1,
    inner=48,
    heads=2,
    rows=4,
    length=64,
    dropout=0.1,
)


@pytest.fixture(scope="module")
def facts() -> Facts:
    return load_facts()


@pytest.fixture(scope="module")
def tokenizer(facts: Facts) -> str:
    return str(train_tokenizer(facts, RECIPE.vocabulary, count=400).to_str())


def _training(work: Path, facts: Facts, tokenizer: str, recipe: Recipe = RECIPE) -> Training:
    work.mkdir(exist_ok=True)
    (work / "tokenizer.json").write_text(tokenizer, encoding="utf-8")
    training = Training(recipe, facts, work)
    training.resume()
    return training


def test_a_stopped_training_ends_where_an_uninterrupted_one_does(
    tmp_path: Path, facts: Facts, tokenizer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So few documents take no time to write, and fill fewer batches than the six.
    monkeypatch.setattr(packing, "_CHUNK_DOCUMENTS", 25)
    whole = _training(tmp_path / "whole", facts, tokenizer)
    train(whole, measure_every=100, judge_sets=1)
    train(_training(tmp_path / "parts", facts, tokenizer), 100, judge_sets=1, stop_at=3)
    resumed = _training(tmp_path / "parts", facts, tokenizer)
    assert resumed.step == 3
    assert resumed.position == (0, 3)
    train(resumed, measure_every=100, judge_sets=1)
    assert resumed.step == whole.step == RECIPE.steps == 6
    assert resumed.position == whole.position
    assert whole.position[0] == 1, "the second chunk was not begun"
    for name, value in whole.average.state_dict().items():
        assert torch.equal(value, resumed.average.state_dict()[name]), name
    assert len((tmp_path / "parts" / "progress.csv").read_text().splitlines()) == 3
    assert (tmp_path / "parts" / "progress.png").stat().st_size > 5_000


def test_a_checkpoint_of_another_recipe_is_refused(
    tmp_path: Path, facts: Facts, tokenizer: str
) -> None:
    _training(tmp_path, facts, tokenizer).save()
    with pytest.raises(click.ClickException, match="another --work"):
        _training(tmp_path, facts, tokenizer, Recipe(width=32, layers=1, inner=48, heads=2))


def test_the_export_loads_as_any_model_does(tmp_path: Path, facts: Facts, tokenizer: str) -> None:
    from roomtables.lm import load_scorer

    export(_training(tmp_path / "work", facts, tokenizer), tmp_path / "model")
    scorer = load_scorer(str(tmp_path / "model"))
    assert scorer.strategy == "trie"
    assert scorer.score(["A lamp is lit."])[0].log_prob < 0


def test_documents_share_a_row_and_see_nothing_of_each_other(facts: Facts, tokenizer: str) -> None:
    from tokenizers import Tokenizer

    bos = Tokenizer.from_str(tokenizer).token_to_id(BOS)
    posterior = Posterior(World(facts), Tokenizer.from_str(tokenizer))
    batch, _ = next(batches(posterior, 1, 8, 64, (0, 0)))
    starts = (batch.ids == bos) & (batch.document >= 0)
    assert torch.equal(starts, (batch.positions == 0) & (batch.document >= 0))
    seen = batch.mask()[:, 0] == 0
    apart = batch.document[:, :, None] != batch.document[:, None, :]
    assert not (seen & apart).any()
    assert not seen.triu(1).any()
    last = batch.document != batch.document.roll(-1, 1)
    assert (batch.targets()[last] == -100).all()
    assert ((batch.document >= 0).float().mean() > 0.9).item()
