import math

import pytest

from roomtables.errors import InputError
from roomtables.offline.inputs import read_counts, read_scores
from support import small_space

SPACE = small_space()


def file(tmp_path, text, name="x.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_counts_fill_absent_pairs_with_zero(tmp_path):
    counts = read_counts(file(tmp_path, "object,room,count\nBeds,bedroom,3\n"), SPACE).values
    assert counts["bed", "bedroom"] == 3
    assert counts["bed", "kitchen"] == 0
    assert len(counts) == 16


def test_counts_of_labelled_rooms(tmp_path):
    lines = (
        '{"room_id": "1", "room": "bedroom", "objects": ["bed", "beds", "sink", "ghost"]}\n'
        '{"room_id": "2", "room": "bedroom;kitchen", "objects": ["bed"]}\n'
        '{"room_id": "3", "room": "moon", "objects": ["bed"]}\n'
    )
    counts = read_counts(file(tmp_path, lines, "rooms.jsonl"), SPACE).values
    assert counts["bed", "bedroom"] == 2  # once a room, under its first label
    assert counts["sink", "bedroom"] == 1
    assert sum(counts.values()) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("object,room\nbed,bedroom\n", "missing column `count`"),
        ("object,room,count\nbed,bedroom,nan\n", "line 2: `count` must be a finite number"),
        ("object,room,count\nbed,bedroom,many\n", "line 2: `count` must be a finite number"),
        ("object,room,count\nbed,bedroom,-1\n", "line 2: `count` must be 0 or more"),
        ("object,room,count\nbed,bedroom,1e17\n", "line 2: `count` must be 0 or more and at most"),
        ("object,room,count\nbed,bedroom,1\nBED,bedroom,1\n", "line 3: .* twice"),
    ],
)
def test_malformed_counts_are_named(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        read_counts(file(tmp_path, text), SPACE)


def test_labels_of_another_space_are_told(tmp_path, caplog):
    read_counts(file(tmp_path, "object,room,count\nghost,bedroom,3\n"), SPACE)
    assert "1 labels are not in label space small" in caplog.text


def scores_csv(header, row):
    pairs = [(o.label, r.label) for o in SPACE.objects for r in SPACE.rooms]
    return f"object,room,{header}\n" + "".join(f"{o},{r},{row}\n" for o, r in pairs)


@pytest.mark.parametrize(
    ("header", "row", "reduction", "score"),
    [
        ("log_prob", "-7.5", "sum", -7.5),
        ("log_prob", "-7.5", "mean", -7.5),
        ("mean_log_prob,token_count", "-2.5,4", "sum", -10.0),
        ("mean_log_prob,token_count", "-2.5,4", "mean", -2.5),
        ("mean_log_prob", "-2.5", "mean", -2.5),
    ],
)
def test_scores_and_their_reduction(tmp_path, header, row, reduction, score):
    values = read_scores(file(tmp_path, scores_csv(header, row)), SPACE, reduction).values
    assert len(values) == 16
    assert all(math.isclose(value, score) for value in values.values())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (scores_csv("mean_log_prob", "-1"), "missing column `log_prob`"),
        (scores_csv("log_prob", "-inf"), "line 2: `log_prob` must be a finite number"),
        (scores_csv("log_prob", "-3.5e38"), "line 2: `log_prob` must be a finite number within"),
        ("object,room,log_prob\nbed,bedroom,-1\n", "no score for object 'bed' and room 'bathroom'"),
        ("object,room,log_prob\n", "missing column `log_prob`.*no row"),
    ],
)
def test_malformed_scores_are_named(tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        read_scores(file(tmp_path, text), SPACE, "sum")


def test_the_fingerprint_is_of_the_numbers(tmp_path):
    one = read_counts(file(tmp_path, "object,room,count\nbed,bedroom,3\n"), SPACE)
    same = read_counts(file(tmp_path, "room,object,count\nbedroom,beds,3.0\n", "y.csv"), SPACE)
    other = read_counts(file(tmp_path, "object,room,count\nbed,bedroom,4\n", "z.csv"), SPACE)
    assert one.recorded() == same.recorded() != other.recorded()
