import pytest

from roomtables.config import BuildConfig, pipeline_folder
from roomtables.errors import ConfigError


def test_the_shipped_file_is_the_defaults():
    config = BuildConfig.load()
    assert (config.labels, config.model, config.k) == ("household", "household-lm", 3)
    assert (config.reduction, config.source) == ("sum", "proxy")
    assert (config.combinations, config.evidence_power) == ("auto", 3)
    assert config.template == ("A room containing {objects} is called {room}.",)
    assert next(iter(config.stages)) == "objects"


def test_every_sql_stage_has_its_file():
    stages = BuildConfig.load().stages
    in_python = {"objects", "rooms", "names", "sentence_scores", "queries", "lookup"}
    assert {path.stem for path in pipeline_folder().glob("*.sql")} == set(stages) - in_python


def test_options_win_over_the_file_and_the_file_over_defaults(tmp_path):
    path = tmp_path / "build.toml"
    path.write_text("k = 2\nsmoothing = 1\n")
    config = BuildConfig.load(path, k=4, model=None)
    assert (config.k, config.smoothing, config.model) == (4, 1.0, "household-lm")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("k = 0", "k must be"),
        ("k = true", "`k` must be int"),
        ('k = "3"', "`k` must be int"),
        ("colour = 1", "unknown key `colour`"),
        ("x" * 5000 + " = 1", "unknown key `x{40}`$"),
        ("reduction = 'median'", "reduction must be one of sum, mean"),
        (f"rule = '{'x' * 5000}'", "rule must be one of .*, not 'x{79}$"),
        ("smoothing = -1", "smoothing"),
        ("smoothing = nan", "smoothing"),
        ("smoothing = " + "9" * 400, "`smoothing` must be at most"),
        ("k = -" + "9" * 400, "`k` must be at most"),
        ("template = 'x'", "template"),
        ("template = []", "template must hold at least one sentence"),
        ("template = [1]", "`template` must be a list of strings"),
        ("stages = ['objects']", "copy `\\[stages\\]`"),
        ("[stages]\nobjects = 1", "`stages.objects` must be a list of strings"),
        ("k = ", "not valid TOML"),
        ("evidence_power = -1", "evidence power"),
        ("prior_weight = inf", "prior weight"),
        ("prior_weight = 1e308", "prior weight"),
        ("evidence_power = 1e308", "evidence power"),
    ],
)
def test_wrong_values_are_named(tmp_path, text, said):
    path = tmp_path / "build.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        BuildConfig.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot read .*absent\.toml"):
        BuildConfig.load(tmp_path / "absent.toml")
