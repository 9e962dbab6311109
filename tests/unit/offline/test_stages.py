"""What build.toml lists is what runs: the order of the stages, and what each of them is handed."""

import json

import pytest

from roomtables import RoomTables, build
from roomtables.config import BuildConfig
from roomtables.errors import ConfigError
from roomtables.offline.inputs import Inputs
from roomtables.offline.plan import plan
from roomtables.offline.stages import STAGES, Stage, listed_stages
from roomtables.offline.tables import Tables
from roomtables.offline.workspace import workspace
from roomtables.schemas import VERSION_TABLES
from roomtables.storage.lookup_writer import LookupSettings
from roomtables.storage.score_cache import NO_SCORES
from roomtables.storage.versions import LOOKUP, SpaceFolder
from support import HashScorer


def config_of(tmp_path, stages):
    """A build.toml with these stages."""
    path = tmp_path / "build.toml"
    lines = [f"{name} = {json.dumps(list(reads))}" for name, reads in stages.items()]
    path.write_text("\n".join(["[stages]", *lines]))
    return BuildConfig.load(path)


def refused(tmp_path, labels, stages, said):
    """`build` and `plan` refuse these stages before they ask or write anything."""
    config = config_of(tmp_path, stages)
    scorer = HashScorer()
    for command in (build, plan):
        with pytest.raises(ConfigError, match=said):
            command(config, tables=tmp_path / "t", labels=labels, scorer=scorer)
    assert scorer.asked == []
    assert not (tmp_path / "t").exists()


def test_an_unknown_stage(tmp_path, labels):
    stages = {**BuildConfig.load().stages, "nonsense": ("objects",)}
    refused(tmp_path, labels, stages, "there is no stage `nonsense`")


@pytest.mark.parametrize("stage", STAGES)
def test_a_missing_stage(tmp_path, labels, stage):
    stages = {name: reads for name, reads in BuildConfig.load().stages.items() if name != stage}
    refused(tmp_path, labels, stages, f"stage `{stage}` is missing")


def test_a_stage_that_reads_what_comes_later_or_is_nothing(tmp_path, labels):
    stages = dict(BuildConfig.load().stages)
    first = {"entropy": stages.pop("entropy")} | stages
    refused(tmp_path, labels, first, "stage `entropy` reads `cooccurrence`, which is no stage")
    stages = BuildConfig.load().stages | {"rooms": ("rooms.csv", "colour")}
    refused(tmp_path, labels, stages, "stage `rooms` reads `colour`")


def test_a_stage_is_handed_what_it_reads_and_nothing_else(tmp_path, labels, counts):
    """Whatever is dropped from the list of a stage, its table cannot be made: all of it is used."""
    config = BuildConfig.load(labels=labels, counts=counts)
    with workspace(tmp_path) as work:
        unscored = work.view("sentence_scores", NO_SCORES)
        tables = Tables(work, Inputs.read(config), lambda _: unscored)
        for stage in listed_stages(config)[:-1]:
            for dropped in stage.reads:
                fewer = tuple(read for read in stage.reads if read != dropped)
                said = rf"build\.toml: stage `{stage.name}`|{stage.name}\.sql: .*build\.toml reads"
                with pytest.raises(ConfigError, match=said):
                    tables.make(Stage(stage.name, fewer))
            tables.make(stage)


def test_the_last_stage_reads_what_is_published(tmp_path, labels):
    stages = BuildConfig.load().stages
    assert set(stages[LOOKUP]) == {*VERSION_TABLES, *LookupSettings._fields}
    for dropped in ("names", "prior_weight"):
        fewer = tuple(read for read in stages[LOOKUP] if read != dropped)
        config = config_of(tmp_path, stages | {LOOKUP: fewer})
        with pytest.raises(ConfigError, match=f"stage `lookup` needs `{dropped}`"):
            build(config, tables=tmp_path / "t", labels=labels, scorer=HashScorer())
    assert SpaceFolder(tmp_path / "t", "small").published() is None


def test_settings_made_in_python_have_the_packages_stages(tmp_path, labels):
    report = build(BuildConfig(labels=labels, k=1), tables=tmp_path / "t", scorer=HashScorer())
    assert report.published
    stages = SpaceFolder(tmp_path / "t", "small").current().manifest.stages
    assert set(stages) == set(BuildConfig.load().stages)


def test_another_order_makes_the_same_tables(tmp_path, labels, counts):
    stages = BuildConfig.load().stages
    order = ["rooms", "names", "objects", "sentence_scores", "cooccurrence", "room_bias"]
    other = {name: stages[name] for name in order} | stages
    assert list(other) != list(stages)
    options = {"labels": labels, "counts": counts}
    answers = []
    for name, config in (("a", None), ("b", config_of(tmp_path, other))):
        build(config, tables=tmp_path / name, scorer=HashScorer(), **options)
        tables = RoomTables.open(tmp_path / name, "small", offline=True)
        answers.append(tables.classify(["sink", "bed"]).as_json())
    assert answers[0] == answers[1]
    found = plan(config_of(tmp_path, other), tables=tmp_path / "b", scorer=HashScorer(), **options)
    assert [stage.stage for stage in found.stages] == list(other)
    assert {stage.state for stage in found.stages} == {"cached"}
