"""What robots call things, read as objects of a label space."""

from __future__ import annotations

import time
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.config import builtin_labels, load_labels
from roomtables.labels import LABEL, PLURAL, SYNONYM, Name, normalise
from roomtables.names import COMPOUND, SPELLING, NameReader

OBJECTS = (
    "bar", "bed", "book", "bottle", "cabinet", "chair", "chest of drawers", "cutting board", "dog",
    "door", "drawer", "e-reader", "garbage can", "iron", "lamp", "mirror", "oven", "shoe", "sofa",
    "soap", "table", "teacher's desk", "television", "toy", "tv stand", "walk-in cooler",
)  # fmt: skip
NAMES = (
    {name: Name(name, LABEL) for name in OBJECTS}
    | {f"{name}s": Name(name, PLURAL) for name in ("book", "chair", "dog", "drawer", "lamp")}
    | {"shoes": Name("shoe", PLURAL)}
    | {"tv": Name("television", SYNONYM), "couch": Name("sofa", SYNONYM)}
    | {"dining chair": Name("chair", SYNONYM), "trash can": Name("garbage can", SYNONYM)}
)


@cache
def reader() -> NameReader:
    return NameReader(NAMES)


@cache
def builtin_reader(space: str) -> NameReader:
    return NameReader(load_labels(space).object_names)


@pytest.mark.parametrize(
    ("name", "label", "how"),
    [
        ("chair", "chair", LABEL),
        ("chairs", "chair", PLURAL),
        ("couch", "sofa", SYNONYM),
        *((name, "chair", SPELLING) for name in ("Chair", " CHAIR ", "ｃｈａｉｒ", "chair_merged")),
        *((name, "chair", SPELLING) for name in ("chair_12", "Chair-2", "chair.003", "chair12")),
        *((name, "chair", SPELLING) for name in ("chair #4", "chair (2)", "chair[7]", "Chairs_3")),
        *((name, "chair", SPELLING) for name in ("chair no. 4", "chair_3e5ab1c2", "Chair|2|1|0")),
        *((name, "chair", SPELLING) for name in ("chair_(for_one_person)", "chair_a3")),
        *((name, "tv stand", SPELLING) for name in ("TVStand", "tvStand", "tv_stand", "TV-STAND")),
        *((name, "tv stand", SPELLING) for name in ("TvStand2", "tvstand", "TV  Stand (left)")),
        *((name, "teacher's desk", SPELLING) for name in ("teachers desk", "Teacher’s_Desk")),
        *((name, "e-reader", SPELLING) for name in ("EReader", "e reader", "ereader_4")),
        ("trashcan", "garbage can", SPELLING),
        ("trash_can-01", "garbage can", SPELLING),
        ("wooden dining chair", "chair", COMPOUND),
        ("WoodenChair_2", "chair", COMPOUND),
        ("old walk-in cooler", "walk-in cooler", COMPOUND),
        ("2 chairs", "chair", COMPOUND),
        ("flatTVs", None, None),  # no name here is the plural of tv
    ],
)
def test_a_name_is_read(name, label, how):
    assert reader().read(name) == (label and Name(label, how))


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("bottle of water", "bottle"),
        ("green bottle of milk on table", "bottle"),
        ("antique chest of drawers", "chest of drawers"),
        ("set of drawers", "drawer"),
        ("bed with canopy", "bed"),
        ("bed with toy", "bed"),
        ("mirror on the door", "mirror"),
        ("oven next to table", "oven"),
        ("built-in oven", "oven"),
        ("built_in_oven_2", "oven"),
        ("pair of shoes", "shoe"),
        ("large pile of old books", "book"),
        ("bar of soap", "soap"),
        ("gizmo with mirror", None),
        ("gizmo for dog", None),
    ],
)
def test_what_stands_before_a_preposition_is_the_thing(name, label):
    found = reader().read(name)
    assert (found and found.label) == label


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("door, double door", "door"),
        ("sofa/couch", "sofa"),
        ("Cutting/chopping Board", None),
        ("Moniter/TV", "television"),
        ("gizmo; red lamp", "lamp"),
        ("table-other", "table"),
        ("bathroom cabinet-merged", "cabinet"),
    ],
)
def test_lists_and_catch_alls_of_label_sets(name, label):
    found = reader().read(name)
    assert (found and found.label) == label


@pytest.mark.parametrize(
    "name",
    [
        "hot dog",
        "red hot dog",
        "HotDogs",
        "chocolate bar",
        "no chair",
        "NonChair",
        "12",
        "#4",
        "a",
        "",
        " ",
        "_-_",
    ],
)
def test_a_tail_that_means_something_else_is_not_read(name):
    assert reader().read(name) is None


def test_a_toy_is_no_more_than_a_toy():
    assert reader().read("toy oven") == Name("toy", COMPOUND)
    without = NameReader({name: found for name, found in NAMES.items() if name != "toy"})
    assert without.read("toy oven") is None


def test_a_single_letter_is_read_only_where_it_is_all_that_is_given():
    letters = NameReader({"a": Name("a", LABEL), "b c": Name("b c", LABEL)})
    assert letters.read("A") == Name("a", SPELLING)
    assert letters.read("vitamin a") is None


def test_a_name_with_a_number_wins_over_the_number_as_a_suffix():
    numbered = NameReader({name: Name(name, LABEL) for name in ("chair", "chair12", "tv 3")})
    assert numbered.read("Chair12") == Name("chair12", SPELLING)
    assert numbered.read("chair 12") == Name("chair12", SPELLING)
    assert numbered.read("chair 13") == Name("chair", SPELLING)


def test_a_label_has_a_better_claim_to_a_spelling_than_a_synonym_or_a_plural():
    both = {"x-ray": Name("scan", SYNONYM), "x ray": Name("fish", PLURAL), "xray": Name("z", LABEL)}
    assert NameReader(both).read("xRay") == Name("z", SPELLING)


@pytest.mark.parametrize("space", builtin_labels())
def test_variants_of_every_builtin_label_read_as_it(space):
    labels = load_labels(space)
    known = labels.object_names
    written = {name: found for name, found in known.items() if found.how != PLURAL}
    for name, found in written.items():
        variants = {
            name.upper(), name.title(), name.replace(" ", "_"), name.replace(" ", "-"),
            name.title().replace(" ", ""), f"{name}_12", f"{name}-2", f"{name}.003", f"{name} #4",
            f"{name} (2)", f" {name.title().replace(' ', '')}7 ", f"{name.replace(' ', '_')}_0_1",
        }  # fmt: skip
        for variant in variants:
            owner = known.get(normalise(variant), found).label
            read = builtin_reader(space).read(variant)
            assert read in {Name(owner, SPELLING), known.get(variant)}, variant


@pytest.mark.parametrize("space", builtin_labels())
def test_every_listed_name_reads_as_the_table_says(space):
    for name, found in load_labels(space).object_names.items():
        assert builtin_reader(space).read(name) == found
        assert builtin_reader(space).read(found.label) == Name(found.label, LABEL)


WORDS = st.sampled_from([*OBJECTS, "of", "with", "built", "no", "toy", "A3", "12", "(", ")", "/"])
SOME = st.text() | st.lists(WORDS | st.text(max_size=4), max_size=8).map(" ".join)


@given(SOME)
def test_any_string_is_read_or_not_and_reading_again_changes_nothing(name):
    found = reader().read(name)
    if found is not None:
        assert found.label in OBJECTS
        assert reader().read(found.label) == Name(found.label, LABEL)
    assert reader().read(name) == found


@given(SOME, st.sampled_from(["{} ", " {}", "{}\t"]))
def test_space_around_a_name_does_not_matter(name, around):
    before, after = reader().read(name), reader().read(around.format(name))
    assert (before and before.label) == (after and after.label)


@pytest.mark.parametrize(
    "long", ["a" * 10_000, "chair " * 2_000, "(" * 200, "bar of " * 28, "A1" * 100, "\ufdfa" * 200]
)
def test_time_is_bounded_for_long_names(long):
    started = time.perf_counter()
    for _ in range(10):
        reader().read(long)
        reader().nearest(long)
    assert time.perf_counter() - started < 1.0


def test_suggestions_are_the_nearest_names_one_per_object():
    assert reader().nearest("miror") == ["mirror"]
    assert reader().nearest("Chiars")[0] == "chairs"
    assert reader().nearest("chiar", most=1) == ["chair"]
    assert reader().nearest("unlike anything") == []
    assert reader().nearest("") == []
