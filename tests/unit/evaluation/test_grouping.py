"""Top-3 and grouped accuracy, by hand and against plain loops; files of groups, good and bad."""

import csv
import json

import pytest
from click.testing import CliRunner

from roomtables import RoomTables, build, evaluate
from roomtables.cli import main
from roomtables.config import builtin_labels, load_labels, pipeline_folder
from roomtables.errors import InputError
from roomtables.evaluation.grouping import in_one_group, read_groups
from roomtables.rooms import Room
from tiny_tables import FitScorer

PLACES = ("bedroom", "hall", "kitchen", "office", "study", "yard")
FITS = {"crib": "bedroom", "desk": "office", "door": "hall", "oven": "kitchen", "rack": "study"}
ROOMS = [
    Room("1", ("crib",), ("bedroom",)),
    Room("2", ("desk",), ("study",)),
    Room("3", ("oven",), ("bedroom", "kitchen")),
    Room("4", ("rack", "desk"), ("hall", "office")),
    Room("5", ("door",), ("kitchen",)),
    Room("6", ("piano",), ("office",)),
]


class PairScorer(FitScorer):
    """An object says its room most, and the others less the later in the alphabet."""

    scorer_id = "pair-scorer"

    def _one(self, sentence):
        fits = sum(3.0 for thing, room in FITS.items() if thing in sentence and room in sentence)
        place = next(at for at, room in enumerate(PLACES) if sentence.endswith(f"{room}."))
        return super()._one(sentence)._replace(log_prob=fits - place / 4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("groups")
    labels = folder / "flat"
    labels.mkdir()
    (labels / "objects.csv").write_text("object\n" + "".join(f"{thing}\n" for thing in FITS))
    rooms = "".join(f"{room},{'den' * (room == 'study')},{room != 'yard'}\n" for room in PLACES)
    (labels / "rooms.csv").write_text("room,synonyms,predicted\n" + rooms)
    build(tables=folder / "tables", scorer=PairScorer(), labels=str(labels), combinations="all")
    return folder / "tables"


@pytest.fixture(scope="module")
def tables(folder):
    return RoomTables.open(folder, "flat", offline=True)


@pytest.fixture
def groups_file(tmp_path):
    def written(*rows, header="room,group"):
        path = tmp_path / "groups.csv"
        path.write_text("\n".join((header, *rows)) + "\n")
        return path

    return written


def test_top_3_by_hand(tables):
    found = evaluate(ROOMS, tables)
    assert [judged.prediction.room for judged in found.judged] == [
        "bedroom", "office", "kitchen", "office", "hall", None,
    ]  # fmt: skip
    # 1: first. 2: after office come bedroom and hall. 3: first. 4: first. 5: third. 6: unanswered.
    assert [judged.in_top for judged in found.judged] == [True, False, True, True, True, False]
    assert found.top_3_accuracy == pytest.approx(4 / 6)
    assert found.as_json()["top_3_accuracy"] == found.top_3_accuracy


def test_top_3_is_what_a_plain_loop_over_what_the_rule_compares_counts(tables):
    for rule in ("query", "calibrated", "pooled"):
        found = evaluate(ROOMS, tables.deciding(rule=rule))
        right = 0
        for judged in found.judged:
            compared = judged.prediction.compared
            if compared is None:
                continue
            names = judged.prediction.decider.candidates.names
            ranked = sorted(zip(-compared, names, strict=True))
            right += bool({name for _, name in ranked[:3]} & set(judged.truth))
        assert found.top_3_accuracy == right / len(ROOMS)


def test_an_answer_too_unsure_to_be_given_is_wrong_in_every_accuracy(tables):
    found = evaluate(ROOMS, tables.deciding(min_probability=0.999), groups={"office": "work"})
    assert found.unanswered.total() == len(ROOMS)
    assert (found.accuracy, found.top_3_accuracy, found.grouped_accuracy) == (0, 0, 0)


def test_grouped_accuracy_by_hand(tables, groups_file):
    groups = read_groups(groups_file("office,work", "den,work", "yard,outside"), tables)
    assert groups == {"office": "work", "study": "work", "yard": "outside"}
    found = evaluate(ROOMS, tables, groups=groups)
    # As without groups, and room 2, a study that is called an office.
    assert (found.correct, found.grouped_accuracy) == (3, pytest.approx(4 / 6))
    assert found.as_json()["grouped_accuracy"] == found.grouped_accuracy


def test_a_room_that_no_row_names_is_a_group_of_its_own(tables, groups_file):
    groups = read_groups(groups_file("office,kitchen", "study,kitchen"), tables)
    assert in_one_group(groups, "office", "study")
    assert in_one_group(groups, "bedroom", "bedroom")
    assert not in_one_group(groups, "office", "kitchen")  # a room, not the group of that name
    assert not in_one_group(groups, "bedroom", "hall")
    assert evaluate(ROOMS, tables, groups={}).grouped_accuracy == evaluate(ROOMS, tables).accuracy


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        (["office,work"], "room,kind", r"groups\.csv: missing column `group`"),
        (["office,work", "kitchne,work"], "room,group",
         r"groups\.csv, line 3: no room 'kitchne' in label space flat; did you mean kitchen\?"),
        (["zzz,work"], "room,group", r"line 2: no room 'zzz' in label space flat; see its rooms"),
        (["study,work", "den,home"], "room,group",
         r"line 3: room 'study' is in group 'work' already"),
        (["study,"], "room,group", r"line 2: `group` is empty"),
        ([",work"], "room,group", r"line 2: `room` is empty"),
        (["study,work,why"], "room,group", r"line 2: expected 2 fields"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_line_that_names_its_place(tables, groups_file, rows, header, message):
    with pytest.raises(InputError, match=message) as raised:
        read_groups(groups_file(*rows, header=header), tables)
    assert "\n" not in str(raised.value)


@pytest.fixture
def run(folder, tmp_path):
    rooms = tmp_path / "rooms.jsonl"
    rooms.write_text("".join(json.dumps(room.as_json()) + "\n" for room in ROOMS))

    def command(*options):
        given = ("evaluate", rooms, "--tables", folder, "--labels", "flat", "--offline", *options)
        return CliRunner().invoke(main, [str(option) for option in given])

    return command


def test_the_command_shows_groups_only_where_they_are_asked_for(run, groups_file):
    path = groups_file("office,work", "study,work")
    plain, grouped = run(), run("--groups", path)
    assert "right among the top 3: 66.7 %\n" in plain.stdout
    assert "right among the top 3: 66.7 %; in the right group: 66.7 %\n" in grouped.stdout
    assert "grouped_accuracy" not in json.loads(run("--format", "json").stdout)
    found = json.loads(run("--format", "json", "--groups", path).stdout)
    assert found["grouped_accuracy"] == pytest.approx(4 / 6)


def test_a_comparison_has_groups_too(run, groups_file):
    path = groups_file("office,work", "study,work")
    asked = ("--compare", "query:proxy,pooled:proxy", "--groups", path, "--format")
    rows = list(csv.DictReader(run(*asked, "csv").stdout.splitlines()))
    conditions = json.loads(run(*asked, "json").stdout)["conditions"]
    for row, condition in zip(rows, conditions, strict=True):
        assert float(row["grouped_accuracy"]) == pytest.approx(condition["grouped_accuracy"])
    assert "grouped" in run(*asked, "table").stdout


def test_wrong_use_is_an_error_of_one_line(run, groups_file):
    assert run("--sweep", "--groups", groups_file()).exit_code == 2
    missing = run("--groups", "nowhere.csv")
    assert (missing.exit_code, missing.stderr.count("\n")) == (1, 1)
    other = run("--groups", "mpcat40")
    assert other.exit_code == 1
    assert "groups.csv, line 2: no room 'living room' in label space flat" in other.stderr


@pytest.mark.parametrize("name", builtin_labels())
def test_built_in_groups_are_of_rooms_that_may_be_the_answer_and_give_a_reason(name):
    predicted = {room.label for room in load_labels(name).predicted_rooms}
    path = pipeline_folder() / "labels" / name / "groups.csv"
    with path.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert {row["room"] for row in rows} <= predicted
    assert len({row["room"] for row in rows}) == len(rows)
    for group in {row["group"] for row in rows}:
        members = [row for row in rows if row["group"] == group]
        assert len(members) > 1
        assert members[0]["reason"]
