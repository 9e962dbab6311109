import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.errors import InputError
from roomtables.rooms import Room, parse_room_lines, read_room_lines

TEXT = st.text(st.characters(blacklist_categories=["Cs"]))


def parse(*lines):
    return list(parse_room_lines(lines, "rooms.jsonl"))


def test_a_room_line():
    line = '{"room_id": "a", "room": "kitchen", "objects": ["stove", "sink"], "area": 3}'
    assert parse(line) == [Room("a", ("stove", "sink"), ("kitchen",))]


@pytest.mark.parametrize("room", ['"kitchen;dining room"', '["kitchen", "dining room"]'])
def test_several_true_labels(room):
    line = f'{{"room_id": "a", "room": {room}, "objects": []}}'
    assert parse(line)[0].truth == ("kitchen", "dining room")


def test_no_truth_and_blank_lines():
    assert parse("", '{"room_id": 7, "room": null, "objects": []}', "\n") == [Room("7", ())]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{", "line 2: invalid JSON"),
        ("[]", "line 2: expected a JSON object"),
        ('{"objects": []}', "line 2: `room_id`"),
        ('{"room_id": true, "objects": []}', "line 2: `room_id`"),
        ('{"room_id": "a"}', "line 2: `objects`"),
        ('{"room_id": "a", "objects": "bed"}', "line 2: `objects`"),
        ('{"room_id": "a", "objects": [1]}', "line 2: `objects`"),
        ('{"room_id": "a", "room": 3, "objects": []}', "line 2: `room`"),
        (b'\xff{"room_id": "a", "objects": []}', "line 2: not UTF-8"),
        ("[" * 100_000, "line 2: nested more than 100 deep"),
        ("1" * 5000, "line 2: an integer of more than 20 digits"),
        ('{"room_id": "a", "objects": ["\\ud800"]}', "line 2: half of a surrogate pair"),
        ('{"room_id": "a", "objects": [], "counts": [NaN]}', "line 2: invalid JSON"),
        ('{"room_id": "a", "objects": ["' + "x" * 10_001 + '"]}', "line 2: a name of more than"),
    ],
)
def test_malformed_lines_are_named(line, said):
    with pytest.raises(InputError, match=rf"rooms\.jsonl, {said}"):
        parse('{"room_id": "first", "objects": []}', line)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"cannot read .*absent\.jsonl"):
        list(read_room_lines(tmp_path / "absent.jsonl"))


@given(TEXT, st.lists(TEXT), st.lists(TEXT.filter(lambda t: ";" not in t and t.strip() == t != "")))
def test_round_trip(room_id, objects, truth):
    room = Room(room_id, tuple(objects), tuple(truth))
    assert parse(json.dumps(room.as_json())) == [room]


@given(st.binary())
def test_any_bytes_are_rooms_or_an_input_error(data):
    with contextlib.suppress(InputError):
        parse(*data.split(b"\n"))
