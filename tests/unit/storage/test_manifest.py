"""A manifest is read back as it was written, and whatever else stands in its file is refused."""

import json
from copy import deepcopy
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roomtables import build
from roomtables.config import BuildConfig
from roomtables.errors import StoreError
from roomtables.storage.manifest import Coverage, Manifest, ManifestError, Rate
from roomtables.storage.versions import SpaceFolder, Version
from support import HashScorer, made_manifest, small_space, write_space


@pytest.fixture(scope="module")
def version(tmp_path_factory):
    """A version that a build published, with counts and a rate."""
    folder = tmp_path_factory.mktemp("manifest")
    counts = folder / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,3\n")
    labels = str(write_space(folder / "labels", small_space()))
    build(tables=folder / "t", scorer=HashScorer(), labels=labels, counts=counts, k=2)
    return SpaceFolder(folder / "t", "small").current()


def test_what_is_written_is_read_back(version):
    manifest = version.manifest
    assert Manifest.from_bytes(manifest.to_bytes()) == manifest
    assert manifest.rate is not None
    assert manifest.combinations == {"ground_truth": 10, "proxy": 10}
    assert set(manifest.files) >= {"query_scores.parquet", "lookup/lookup.json"}


def test_every_setting_of_the_build_stands_there_by_value(version):
    content = json.loads(version.manifest.to_bytes())
    assert content["settings"].keys() == BuildConfig.recorded_names()
    assert content["settings"]["k"] == 2
    assert content["settings"]["template"] == ["A room containing {objects} is called {room}."]
    assert content["settings"]["counts"].endswith("counts.csv")
    assert content["stages"]["query_scores"]["reduction"] == "sum"
    assert content["stages"]["query_scores"]["model"] == "hash@1"


def test_coverage_counts_what_is_held_and_what_the_rest_takes(tmp_path):
    manifest = made_manifest(tmp_path, combinations={"proxy": 4})
    assert manifest.coverage == Coverage(14, 4, 10 * 3, None)
    timed = replace(manifest, rate=Rate(60.0, 9.0, 100, 1))
    assert timed.coverage.rest_seconds == 0.5


ALIKE = {"files", "rows", "stages", "combinations", "model"}


def mutations(value, path=()):
    """Every place of a manifest; of entries that are all alike, the first."""
    yield path
    if isinstance(value, dict):
        for key, inner in list(value.items())[: 1 if path[-1:] and path[-1] in ALIKE else None]:
            yield from mutations(inner, (*path, key))
    if isinstance(value, list):
        for at, inner in enumerate(value):
            yield from mutations(inner, (*path, at))


def changed(document, path, change):
    """A document with the value at a path replaced, or, where there is no change, dropped."""
    if not path:
        return change[0] if change else {}
    document = deepcopy(document)
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    if change:
        inner[path[-1]] = change[0]
    else:
        del inner[path[-1]]
    return document


WRONG = [
    None, True, -1, 10**30, 1.5, float("nan"), float("inf"), "", "x", "\ud800", [], [1], ["\ud800"],
    {}, {"a": 1}, {"\ud800": 1}, "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00",
    "2026-01-01T00:00:00",
]  # fmt: skip


def opens_or_says_why(folder, document):
    """A file of a document is a version, or one line of words."""
    (folder / "manifest.json").write_text(json.dumps(document))
    said = ""
    try:
        opened = Version.open(folder)
    except StoreError as error:
        said = str(error)
    if said:
        assert "\n" not in said
        assert "roomtables build" in said
        said.encode()
    else:
        assert opened.manifest.created.year > 1969
        assert opened.manifest.coverage.combinations >= 0
        assert Manifest.from_bytes(opened.manifest.to_bytes())


def test_no_structured_mutation_gets_past_the_reader(version, tmp_path):
    document = json.loads(version.manifest.to_bytes())
    folder = tmp_path / "home" / "v"
    folder.mkdir(parents=True)
    for path in mutations(document):
        for change in ([], *([wrong] for wrong in WRONG)):
            opens_or_says_why(folder, changed(document, path, change))


@settings(max_examples=40)
@given(st.data())
def test_two_mutations_at_once_neither(version, tmp_path_factory, data):
    document = json.loads(version.manifest.to_bytes())
    folder = tmp_path_factory.mktemp("home") / "v"
    folder.mkdir()
    for _ in range(2):
        path = data.draw(st.sampled_from([path for path in mutations(document) if path]))
        wrong = data.draw(st.sampled_from(WRONG) | st.text(max_size=5) | st.integers())
        document = changed(document, path, [wrong])
    opens_or_says_why(folder, document)


@pytest.mark.parametrize(
    ("path", "wrong", "said"),
    [
        (("labels",), None, "it lacks `labels`"),
        (("colour",), "blue", "it holds the unknown key `colour`"),
        (("objects",), "4", "`objects` is of the wrong type"),
        (("objects",), True, "`objects` is of the wrong type"),
        (
            ("files", "entropy.parquet", "bytes"),
            [],
            "`files.entropy.parquet.bytes` is of the wrong",
        ),
        (("created",), "0001-01-01T00:00:00+14:00", "`created` is no time with a time zone"),
        (("created",), "yesterday", "`created` is no time"),
        (("settings", "k"), 0, "k must be from 1 to 8, not 0"),
        (("settings", "prior_weight"), "x", "`prior_weight` must be float"),
        (("settings", "rule"), None, "it lacks `settings.rule`"),
        (("scorer_id",), "\ud800", "half of a surrogate pair"),
        (("settings", "template"), "x" * 20_000, "^template 'x{100}"),
        (("settings", "reduction"), "x" * 20_000, "reduction must be one of"),
        (("files", "x" * 5000), {"bytes": 1, "sha256": ""}, "which is no file of a version"),
        (("files", "../000001-x/a"), {"bytes": 1, "sha256": ""}, "which is no file of a version"),
        (("files", "/etc/passwd"), {"bytes": 1, "sha256": ""}, "which is no file of a version"),
        (("files", "a\x00b"), {"bytes": 1, "sha256": ""}, "which is no file of a version"),
    ],
)
def test_what_is_wrong_is_named(version, path, wrong, said):
    document = json.loads(version.manifest.to_bytes())
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    if wrong is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = wrong
    with pytest.raises(ManifestError, match=said) as caught:
        Manifest.from_bytes(json.dumps(document).encode())
    assert len(str(caught.value)) < 1000
