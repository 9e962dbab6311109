"""Each kind of change: the cause that `plan` names, and the sentences that it foretells."""

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from roomtables import build
from roomtables.config import BuildConfig, pipeline_folder
from roomtables.offline.plan import plan
from roomtables.sentences import Template
from roomtables.storage.miss_log import FOLDER, MissLog
from roomtables.storage.versions import SpaceFolder
from support import HashScorer

OBJECTS = """object,plural,synonyms
bed,beds,
sink,sinks,
stove,stoves,cooker
toilet,toilets,
"""
ROOMS = """room,article,synonyms,predicted
bathroom,a,,
bedroom,a,,
kitchen,a,,
yard,a,,false
"""
COUNTS = "object,room,count\nbed,bedroom,9\nsink,kitchen,2\nsink,bathroom,3\nstove,kitchen,4\n"


@dataclass
class Site:
    """A label space, its tables, and the arguments of the next build."""

    root: Path
    model: str = "hash@1"
    options: dict = field(default_factory=dict)

    @property
    def tables(self):
        return self.root / "t"

    @property
    def space(self):
        return SpaceFolder(self.tables, "small")

    def write(self, name, text):
        path = self.root / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return path

    def edit(self, name, old, new):
        text = (self.root / name).read_text()
        assert old in text
        self.write(name, text.replace(old, new))

    def settings(self):
        return {"tables": self.tables, "labels": str(self.root / "small")} | self.options

    def plan(self, **options):
        return plan(scorer=HashScorer(self.model), **self.settings(), **options)

    def build(self):
        return build(scorer=HashScorer(self.model), **self.settings())


@pytest.fixture
def site(tmp_path):
    made = Site(tmp_path)
    made.write("small/objects.csv", OBJECTS)
    made.write("small/rooms.csv", ROOMS)
    made.write("counts.csv", COUNTS)
    rows = [f"{o},{r},-{n}\n" for n, o in enumerate(("bed", "sink", "stove", "toilet"), 1)
            for r in ("bathroom", "bedroom", "kitchen", "yard")]  # fmt: skip
    made.write("scores.csv", "object,room,log_prob\n" + "".join(rows))
    made.write("rooms.jsonl", json.dumps({"room_id": "1", "objects": ["sink", "bed"]}) + "\n")
    return made


KINDS = {}
FILES = (".csv", ".jsonl")


def kind(stage, why, before=None, exact=True):
    """A kind of change: the stage it is noticed at, and the cause that is named there."""

    def noted(change):
        KINDS[change.__name__] = (change, stage, why, before or {}, exact)
        return change

    return noted


@kind("sentence_scores", "template changed")
def another_template(site):
    site.options["template"] = "Rooms with {objects}: {room}."


@kind("sentence_scores", "template added", exact=False)
def another_template_beside_it(site):
    site.options["template"] = [Template().text, "Rooms with {objects}: {room}."]


TWO = ["Rooms with {objects}: {room}.", "A place of {objects} is {room}."]


@kind("sentence_scores", "template removed", {"template": TWO})
def one_template_less(site):
    site.options["template"] = TWO[:1]


@kind("sentence_scores", "templates in another order", {"template": TWO})
def templates_turned_round(site):
    site.options["template"] = TWO[::-1]


@kind("sentence_scores", "scored sentence → after_room", {"template": "In {room}: {objects}."})
def only_what_stands_behind_the_room(site):
    site.options["scored"] = "after_room"


@kind("sentence_scores", "hash: weights, tokenizer or device changed")
def other_weights(site):
    site.model = "hash@2"


@kind("sentence_scores", "model hash → other")
def another_model(site):
    site.model = "other@1"


@kind("sentence_scores", "dtype float32 → float16")
def another_dtype(site):
    site.model, site.options["dtype"] = "hash@2", "float16"


@kind("sentence_scores", "scores.csv added")
def scores_instead_of_the_model(site):
    site.options["scores"] = site.root / "scores.csv"


@kind("sentence_scores", "scores.csv left out", {"scores": "scores.csv"}, exact=False)
def the_model_instead_of_scores(site):
    del site.options["scores"]


@kind("sentence_scores", "scores.csv changed", {"scores": "scores.csv"})
def other_scores(site):
    site.edit("scores.csv", "bed,yard,-1", "bed,yard,-7")


@kind("cooccurrence", "reduction sum → mean")
def another_reduction(site):
    site.options["reduction"] = "mean"


@kind("cooccurrence", "smoothing 0.25 → 3")
def another_smoothing(site):
    site.options["smoothing"] = 3.0


@kind("cooccurrence", "counts.csv added")
def counts_come(site):
    site.options["counts"] = site.root / "counts.csv"


@kind("cooccurrence", "counts.csv left out", {"counts": "counts.csv"})
def counts_go(site):
    del site.options["counts"]


@kind("cooccurrence", "counts.csv changed", {"counts": "counts.csv"})
def counts_change(site):
    site.edit("counts.csv", "bed,bedroom,9", "bed,kitchen,90")


@kind("queries", "k 3 → 2")
def a_smaller_k(site):
    site.options["k"] = 2


@kind("queries", "k 2 → 3", {"k": 2})
def a_larger_k(site):
    site.options["k"] = 3


@kind("queries", "combinations all → none")
def no_combinations(site):
    site.options["combinations"] = "none"


@kind("queries", "combinations none → all", {"combinations": "none"})
def all_combinations(site):
    site.options["combinations"] = "all"


@kind("queries", "combinations all → rooms.jsonl")
def combinations_of_a_file(site):
    site.options["combinations"] = str(site.root / "rooms.jsonl")


@kind("queries", "rooms.jsonl changed", {"combinations": "rooms.jsonl"})
def another_file_of_rooms(site):
    site.edit("rooms.jsonl", "sink", "stove")


@kind("queries", "1 new miss", {"combinations": "misses"})
def a_miss(site):
    MissLog(site.space.path / FOLDER).note("proxy", [("bed", "sink")])


@kind("queries", "2 new misses", {"combinations": "misses", "k": 2})
def misses(site):
    MissLog(site.space.path / FOLDER).note("proxy", [("bed", "sink"), ("bed", "stove")])


@kind("lookup", "rule query → pooled")
def another_rule(site):
    site.options["rule"] = "pooled"


@kind("lookup", "source proxy → ground_truth", {"counts": "counts.csv"})
def another_source(site):
    site.options["source"] = "ground_truth"


@kind("lookup", "prior_weight 0.5 → 0.7")
def another_prior_weight(site):
    site.options["prior_weight"] = 0.7


@kind("lookup", "evidence_power 3 → 2")
def another_evidence_power(site):
    site.options["evidence_power"] = 2.0


@kind("objects", "object toilet renamed to commode")
def an_object_is_renamed(site):
    site.edit("small/objects.csv", "toilet,toilets,", "commode,commodes,")


@kind("objects", "object stove renamed to cooker; object lamp added")
def an_object_takes_its_synonym_as_label(site):
    site.edit("small/objects.csv", "stove,stoves,cooker", "cooker,cookers,stove\nlamp,lamps,")


@kind("objects", "object lamp added")
def an_object_comes(site):
    site.write("small/objects.csv", OBJECTS + "lamp,lamps,\n")


@kind("objects", "objects lamp, mirror, rug and 1 more added")
def objects_come(site):
    site.write("small/objects.csv", OBJECTS + "lamp,,\nrug,,\nmirror,,\nvase,,\n")


@kind("objects", "object toilet removed")
def an_object_goes(site):
    site.edit("small/objects.csv", "toilet,toilets,\n", "")


@kind("objects", "plural of bed changed")
def another_plural(site):
    site.edit("small/objects.csv", "bed,beds", "bed,bedsteads")


@kind("names", "synonyms of sink changed")
def a_synonym(site):
    site.edit("small/objects.csv", "sink,sinks,", "sink,sinks,basin")


@kind("rooms", "room kitchen renamed to galley", exact=False)
def a_room_is_renamed(site):
    site.edit("small/rooms.csv", "kitchen", "galley")


@kind("rooms", "room attic added", {"counts": "counts.csv"}, exact=False)
def a_room_comes(site):
    site.write("small/rooms.csv", ROOMS + "attic,an,,\n")


@kind("rooms", "room yard removed")
def a_room_goes(site):
    site.edit("small/rooms.csv", "yard,a,,false\n", "")


@kind("rooms", "room yard predicted")
def a_room_is_predicted(site):
    site.edit("small/rooms.csv", "yard,a,,false", "yard,a,,true")


@kind("rooms", "room bedroom no longer predicted")
def a_room_is_predicted_no_more(site):
    site.edit("small/rooms.csv", "bedroom,a,,", "bedroom,a,,false")


@kind("rooms", "article of kitchen changed", exact=False)
def another_article(site):
    site.edit("small/rooms.csv", "kitchen,a", "kitchen,the")


@kind("rooms", "rooms.csv changed")
def a_synonym_of_a_room(site):
    site.edit("small/rooms.csv", "kitchen,a,", "kitchen,a,galley")


@kind("entropy", "entropy.parquet missing")
def a_table_is_gone(site):
    (site.space.current().path / "entropy.parquet").unlink()


@kind("room_bias", "room_bias.parquet damaged")
def a_table_is_damaged(site):
    path = site.space.current().path / "room_bias.parquet"
    path.write_bytes(path.read_bytes()[:-1])


@kind("lookup", "lookup/lookup.json missing")
def a_file_of_the_lookup_is_gone(site):
    (site.space.current().path / "lookup" / "lookup.json").unlink()


@kind("sentence_scores", "score part missing")
def the_scores_are_gone(site):
    shutil.rmtree(site.tables / "scores")


@kind("objects", "full refresh")
def everything_anew(site):
    site.options["full_refresh"] = True


@kind("objects", "not built")
def nothing_is_published(site):
    shutil.rmtree(site.tables)


@kind("objects", "published version unusable")
def current_is_damaged(site):
    (site.space.path / "CURRENT").write_text("nonsense")


@kind("objects", "made by another roomtables")
def another_schema_version(site):
    path = site.space.current().path / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"schema_version": 1}))
    site.space.path.joinpath("CURRENT").write_text(f"{path.parent.name}\n")


@pytest.mark.parametrize("name", KINDS)
def test_a_change_is_named_and_its_sentences_are_foretold(site, name):
    change, stage, why, before, exact = KINDS[name]
    files = {n: site.root / v for n, v in before.items() if str(v).endswith(FILES)}
    site.options = before | {n: str(p) if n == "combinations" else p for n, p in files.items()}
    site.build()
    change(site)
    bound, counted = site.plan(), site.plan(exact=True)
    for found in (bound, counted):
        whys = {state.stage: state.why for state in found.stages}
        assert whys[stage] == why
        assert all(state.why for state in found.stages if state.state != "cached")
        assert any(state.state != "cached" for state in found.stages)
    report = site.build()
    assert report.published
    assert counted.exact is exact
    assert bound.sentences_to_score >= counted.sentences_to_score >= report.sentences_scored
    for found in (bound, counted):
        assert not found.exact or found.sentences_to_score == report.sentences_scored
    site.options.pop("full_refresh", None)
    again = site.plan()
    assert (again.sentences_to_score, again.exact) == (0, True)
    assert {state.state for state in again.stages} == {"cached"}


def test_the_stages_that_follow_name_the_same_cause(site):
    site.build()
    counts_come(site)
    found = {state.stage: (state.state, state.why) for state in site.plan().stages}
    cached, stale = ("cached", ""), ("stale", "counts.csv added")
    assert [name for name, state in found.items() if state == cached] == [
        "objects", "rooms", "names", "sentence_scores",
    ]  # fmt: skip
    assert set(found.values()) == {cached, stale}


def test_several_causes_are_all_named(site):
    site.build()
    an_object_is_renamed(site)
    a_smaller_k(site)
    found = {state.stage: state.why for state in site.plan().stages}
    assert found["queries"] == "object toilet renamed to commode; k 3 → 2"


@pytest.mark.parametrize(("edited", "said"), [("entropy.sql", "entropy.sql changed")])
def test_another_pipeline(site, monkeypatch, edited, said):
    site.build()
    pipeline = site.root / "pipeline"
    shutil.copytree(pipeline_folder(), pipeline)
    (pipeline / edited).write_text((pipeline / edited).read_text() + "-- changed\n")
    monkeypatch.setattr("roomtables.offline.stages.pipeline_folder", lambda: pipeline)
    found = {state.stage: state.why for state in site.plan(exact=True).stages}
    assert (found["cooccurrence"], found["entropy"], found["lookup"]) == ("", said, said)
    assert site.build().sentences_scored == 0


def test_other_stages_in_build_toml(site):
    site.build()
    stages = BuildConfig.load().stages
    site.options["stages"] = stages | {"room_bias": (*stages["room_bias"], "k")}
    found = {state.stage: state.why for state in site.plan().stages}
    assert (found["entropy"], found["room_bias"]) == ("", "[stages] of build.toml changed")


@pytest.mark.parametrize("exact", [False, True])
def test_a_first_build_makes_every_stage_though_it_asks_for_no_combination(site, exact):
    site.options["combinations"] = "misses"
    found = site.plan(exact=exact)
    assert {(state.state, state.why) for state in found.stages} == {("missing", "not built")}
    assert found.sentences_to_score == 4 * 4


def test_too_many_combinations_are_counted_by_formula_and_that_is_said(site, caplog, monkeypatch):
    monkeypatch.setattr("roomtables.offline.plan.MOST_COUNTED", 10)
    found = site.plan(exact=True)
    assert (found.exact, found.sentences_to_score) == (False, 4 * 4 + (6 + 4) * 3)
    assert "14 combinations are too many" in caplog.text


def test_the_formula_does_not_claim_what_the_cache_may_hold(site):
    site.options["combinations"] = "none"
    for site.model in ("hash@1", "hash@2"):
        site.build()
    site.model = "hash@1"
    bound, counted = site.plan(), site.plan(exact=True)
    assert (bound.exact, bound.sentences_to_score) == (False, 4 * 4)
    assert (counted.exact, counted.sentences_to_score) == (True, 0)
    assert site.build().sentences_scored == 0


def test_misses_without_any_publish_nothing_whatever_was_asked_before(site):
    first = site.build()
    site.options["combinations"] = "misses"
    planned = site.plan()
    assert {state.state for state in planned.stages} == {"cached"}
    assert planned.held == planned.coverage.held == 4 + 6 + 4
    report = site.build()
    assert (report.published, report.version) == (False, first.version)
    another_reduction(site)
    assert site.build().published
    assert sum(site.space.current().manifest.combinations.values()) == 4 + 6 + 4


@pytest.mark.parametrize(("k", "more"), [(2, 0), (3, 0), (4, 3)])
def test_the_formula_counts_what_is_held_once(site, k, more):
    """The order of the objects has not changed, so neither have the sentences that are held."""
    site.build()
    site.options["k"] = k
    assert site.plan().sentences_to_score == more


@pytest.mark.parametrize(("change", "sources"), [("counts_come", 1), ("another_reduction", 1)])
def test_the_formula_counts_the_sources_that_change(site, change, sources):
    site.build()
    KINDS[change][0](site)
    assert site.plan().sentences_to_score == sources * (6 + 4) * 3


def test_the_formula_is_the_count_where_nothing_is_held(site):
    found = site.plan()
    assert not found.exact
    assert found.sentences_to_score == 4 * 4 + (6 + 4) * 3 == site.build().sentences_scored


@pytest.mark.parametrize(("objects", "k"), [(205, 3), (1200, 3), (1200, 5)])
def test_the_formula_makes_no_table(site, objects, k):
    site.write("small/objects.csv", "object\n" + "".join(f"thing {n}\n" for n in range(objects)))
    site.options |= {"k": k, "combinations": "all"}
    found = site.plan()
    assert found.sentences_to_score > objects**3 // 6
    assert not list(site.root.glob("t"))
