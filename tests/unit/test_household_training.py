"""Training household-lm: a training that is stopped and resumed ends as one that is not."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import click
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from pipeline.household_lm.answers import Posterior  # noqa: E402
from pipeline.household_lm.facts import Facts, load_facts  # noqa: E402
from pipeline.household_lm.packing import BOS, Batch, batches, train_tokenizer  # noqa: E402
from pipeline.household_lm.train import export, train  # noqa: E402
from pipeline.household_lm.training import Recipe, Training  # noqa: E402
from pipeline.household_lm.world import World  # noqa: E402
from tokenizers import Tokenizer  # noqa: E402

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


@pytest.fixture(scope="module")
def posterior(facts: Facts, tokenizer: str) -> Posterior:
    return Posterior(World(facts), Tokenizer.from_str(tokenizer))


@pytest.fixture(scope="module")
def stream(posterior: Posterior) -> list[tuple[Batch, tuple[int, int]]]:
    """The batches of the recipe, each with the position behind it."""
    found = batches(posterior, RECIPE.seed, RECIPE.rows, RECIPE.length, (0, 0))
    return list(islice(found, RECIPE.steps))


def _training(work: Path, facts: Facts, tokenizer: str, recipe: Recipe = RECIPE) -> Training:
    work.mkdir(exist_ok=True)
    (work / "tokenizer.json").write_text(tokenizer, encoding="utf-8")
    training = Training(recipe, facts, work)
    training.resume()
    return training


def _update(training: Training, batches: Iterable[tuple[Batch, tuple[int, int]]]) -> None:
    for batch, training.position in batches:
        training.update(batch)


def _assert_equal(one: Training, other: Training) -> None:
    assert one.step == other.step
    assert one.position == other.position
    for name, value in one.average.state_dict().items():
        assert torch.equal(value, other.average.state_dict()[name]), name


def test_a_stopped_training_goes_on_where_it_was(
    tmp_path: Path,
    facts: Facts,
    tokenizer: str,
    stream: list[tuple[Batch, tuple[int, int]]],
    posterior: Posterior,
) -> None:
    whole = _training(tmp_path / "whole", facts, tokenizer)
    _update(whole, stream[:4])
    train(_training(tmp_path / "parts", facts, tokenizer), 100, judge_sets=1, stop_at=2)
    resumed = _training(tmp_path / "parts", facts, tokenizer)
    assert resumed.step == 2
    further = batches(posterior, RECIPE.seed, RECIPE.rows, RECIPE.length, resumed.position)
    _update(resumed, islice(further, 2))
    _assert_equal(whole, resumed)
    assert len((tmp_path / "parts" / "progress.csv").read_text().splitlines()) == 2
    assert (tmp_path / "parts" / "progress.png").stat().st_size > 5_000


@pytest.mark.slow
def test_a_stopped_training_ends_where_an_uninterrupted_one_does(
    tmp_path: Path, facts: Facts, tokenizer: str
) -> None:
    whole = _training(tmp_path / "whole", facts, tokenizer)
    train(whole, measure_every=100, judge_sets=1)
    train(_training(tmp_path / "parts", facts, tokenizer), 100, judge_sets=1, stop_at=3)
    resumed = _training(tmp_path / "parts", facts, tokenizer)
    assert resumed.step == 3
    train(resumed, measure_every=100, judge_sets=1)
    _assert_equal(whole, resumed)
    assert resumed.step == RECIPE.steps == 6
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


def test_documents_share_a_row_and_see_nothing_of_each_other(
    posterior: Posterior, stream: list[tuple[Batch, tuple[int, int]]]
) -> None:
    bos = posterior.tokenizer.token_to_id(BOS)
    for batch, _ in stream:
        starts = (batch.ids == bos) & (batch.document >= 0)
        assert torch.equal(starts, (batch.positions == 0) & (batch.document >= 0))
        seen = batch.mask()[:, 0] == 0
        apart = batch.document[:, :, None] != batch.document[:, None, :]
        assert not (seen & apart).any()
        assert not seen.triu(1).any()
        last = batch.document != batch.document.roll(-1, 1)
        assert (batch.targets()[last] == -100).all()
        assert ((batch.document >= 0).float().mean() > 0.9).item()
