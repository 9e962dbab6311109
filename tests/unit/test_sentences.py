import pytest

from roomtables.errors import ConfigError
from roomtables.labels import ObjectLabel, RoomLabel
from roomtables.sentences import Template, enumerate_nouns

OBJECTS = [ObjectLabel.named(name) for name in ("toilet", "sink", "towel", "shelf")]
ROOMS = [RoomLabel.named("bathroom"), RoomLabel.named("office")]


@pytest.mark.parametrize(
    ("count", "sentence"),
    [
        (1, "A room containing toilets is called a bathroom."),
        (2, "A room containing toilets and sinks is called a bathroom."),
        (3, "A room containing toilets, sinks, and towels is called a bathroom."),
        (4, "A room containing toilets, sinks, towels, and shelves is called a bathroom."),
    ],
)
def test_query_sentences(count, sentence):
    assert Template().compose(OBJECTS[:count], ROOMS)[0] == sentence


def test_one_sentence_per_room_in_order():
    assert Template("{room}: {objects}").compose(OBJECTS[:1], ROOMS) == [
        "a bathroom: toilets",
        "an office: toilets",
    ]


@pytest.mark.parametrize(
    "text",
    ["", "{objects}", "{room}", "{objects} {room} {room}", "{objects} {room} {x}", "{", "{}"],
)
def test_a_template_holds_both_placeholders_once(text):
    with pytest.raises(ConfigError, match="template"):
        Template(text)


@pytest.mark.parametrize(
    "text", ["{objects!r} {room}", "{objects:>9} {room}", "{objects[0]} {room}"]
)
def test_a_template_formats_nothing_else(text):
    with pytest.raises(ConfigError, match="template"):
        Template(text)


def test_braces_in_a_label_are_text():
    odd = [ObjectLabel("{room}", "{room}")]
    assert Template().compose(odd, ROOMS[:1]) == ["A room containing {room} is called a bathroom."]


def test_enumerate_nothing():
    assert enumerate_nouns([]) == ""
