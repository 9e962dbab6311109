import os
import random
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.config import builtin_labels, load_labels
from roomtables.errors import InputError, LabelSpaceError
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel, normalise
from support import small_space, write_space


def test_mpcat40_has_the_authors_labels(shared_data):
    space = load_labels("mpcat40")
    counts = (shared_data / "matterport3d" / "mpcat40_room_object_counts.csv").read_text()
    rows = [line.split(",")[:2] for line in counts.splitlines()[1:]]
    assert {o.label for o in space.objects} == {row[0] for row in rows}
    assert {r.label for r in space.rooms} == {row[1] for row in rows}
    unpredicted = {r.label for r in space.rooms if not r.predicted}
    assert unpredicted == {"none", "balcony", "porch", "yard"}


def test_matterports_spellings_are_synonyms(shared_data):
    aliases = load_labels("mpcat40").object_aliases
    rows = (shared_data / "matterport3d" / "mpcat40.tsv").read_text().splitlines()[1:]
    rejected = {"void", "wall", "floor", "ceiling", "objects", "misc", "unlabeled"}
    names = {row.split("\t")[1] for row in rows} - rejected
    found = {aliases.get(normalise(name)) for name in names}
    assert found == {o.label for o in load_labels("mpcat40").objects}


def test_nyuclass_covers_matterports_classes(shared_data):
    import csv

    mapping = shared_data / "matterport3d" / "category_mapping.tsv"
    rejected = {"void", "wall", "floor", "ceiling", "misc", "unlabeled"}
    unnamed = {"wall", "floor", "ceiling", "empty", "unknown", ""}
    with mapping.open(newline="") as file:
        kept = {
            row["nyuClass"].strip()
            for row in csv.DictReader(file, delimiter="\t")
            if row["mpcat40"].strip() not in rejected
        } - unnamed
    space = load_labels("nyuclass")
    assert {space.object_aliases.get(normalise(name)) for name in kept} == {
        o.label for o in space.objects
    }
    assert len(kept) == 206
    assert len(space.objects) == 205  # mantle is a misspelt mantel


def test_builtin_sentences_read_well():
    mpcat40 = load_labels("mpcat40")
    plurals = {o.label: o.plural for o in mpcat40.objects}
    assert plurals["gym equipment"] == "gym equipment"
    assert plurals["shelving"] == "shelves"
    assert plurals["clothes"] == "clothes"
    assert plurals["chest of drawers"] == "chests of drawers"
    phrases = {r.label: r.phrase for r in mpcat40.rooms}
    assert phrases["utility room"] == "a utility room"
    assert phrases["office"] == "an office"


def test_every_builtin_space_loads():
    assert builtin_labels() == ("household", "mpcat40", "nyuclass")
    for name in builtin_labels():
        assert load_labels(name).name == name


@pytest.mark.parametrize(
    ("spelling", "label"),
    [
        ("Toilets", "toilet"),
        (" TV_Monitor ", "tv"),
        ("couches", "sofa"),
        ("stair", "stairs"),
        ("chest_of_drawers", "chest of drawers"),
        ("shelf", "shelving"),
        ("televisions", "tv"),
    ],
)
def test_spellings_of_objects(spelling, label):
    assert load_labels("mpcat40").object_aliases[normalise(spelling)] == label


@pytest.mark.parametrize(
    ("spelling", "label"), [("Meeting Room", "conference room"), ("corridor", "hallway")]
)
def test_spellings_of_rooms(spelling, label):
    assert load_labels("mpcat40").room_aliases[normalise(spelling)] == label


@given(st.text())
def test_normalise_is_idempotent(text):
    assert normalise(normalise(text)) == normalise(text)


def test_the_order_of_a_file_changes_nothing(tmp_path):
    objects = ["zebra rug", "apple", "Bed", "chair"]
    shuffled = random.Random(3).sample(objects, len(objects))
    one = LabelSpace.named("x", objects, ["office", "bar"])
    other = LabelSpace.named("x", shuffled, ["bar", "office"])
    assert one == other
    assert (one.objects, one.rooms) == (other.objects, other.rooms)


def test_round_trip_through_files(tmp_path):
    space = small_space()
    assert LabelSpace.load(write_space(tmp_path, space)) == space


def test_what_a_column_leaves_empty_is_derived(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "objects.csv").write_text("object\nshelf\nox cart\n")
    (folder / "rooms.csv").write_text("room,predicted\noffice,\nattic,no\n")
    space = LabelSpace.load(folder)
    assert [o.plural for o in space.objects] == ["ox carts", "shelves"]
    assert [r.phrase for r in space.rooms] == ["an attic", "an office"]
    assert [r.predicted for r in space.rooms] == [False, True]


@pytest.mark.parametrize(
    ("objects", "rooms", "said"),
    [
        ("thing\nbed\n", "room\noffice\n", "missing column `object`"),
        ("object\nbed\nBed\n", "room\noffice\n", "listed twice"),
        ("object,plural\nbed,beds,x\n", "room\noffice\n", "line 2"),
        ("object\n\n", "room\noffice\n", "no object"),
        ("object,plural\n,x\n", "room\noffice\n", "empty `object`"),
        ("object\nbed\n", "room,predicted\noffice,perhaps\n", "line 2"),
        ("object\nbed\n", "room,predicted\noffice,false\n", "no predicted room"),
        ('object\n"bed\n', "room\noffice\n", "objects.csv"),
    ],
)
def test_malformed_files_are_named(tmp_path, objects, rooms, said):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "objects.csv").write_text(objects)
    (folder / "rooms.csv").write_text(rooms)
    with pytest.raises((InputError, LabelSpaceError), match=said):
        LabelSpace.load(folder)


def test_bytes_that_are_not_utf8_are_named(tmp_path):
    (tmp_path / "objects.csv").write_bytes(b"object\n\xff\xfe\n")
    with pytest.raises(InputError, match=r"objects\.csv: not UTF-8"):
        LabelSpace.load(tmp_path)


def test_a_synonym_belongs_to_one_label():
    objects = (ObjectLabel("bed", "beds", ("cot",)), ObjectLabel("crib", "cribs", ("cot",)))
    with pytest.raises(LabelSpaceError, match="'cot'"):
        LabelSpace("x", objects, (RoomLabel("office", "an"),))


def test_a_label_is_listed_once_however_the_space_was_made():
    twice = (ObjectLabel("bed", "beds"), ObjectLabel("".join("bed"), "beds"))
    with pytest.raises(LabelSpaceError, match="'bed' is listed twice"):
        LabelSpace("x", twice, (RoomLabel("office", "an"),))
    rooms = (RoomLabel("office", "an"), RoomLabel("Office", "an"))
    with pytest.raises(LabelSpaceError, match="is listed twice"):
        LabelSpace("x", twice[:1], rooms)


@pytest.mark.parametrize(
    "name", ["scores", ".x", ".build-lock", ".staging-1", "", "a/b", "a\nb", "a\x1b[2Jb", "\ud800"]
)
def test_a_name_that_the_tables_folder_cannot_hold_is_refused(name):
    with pytest.raises(LabelSpaceError, match="rename it") as caught:
        LabelSpace.named(name, ["bed"], ["bedroom"])
    assert str(caught.value).isprintable()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become nobody")
@pytest.mark.parametrize("closed", [".", "space", "space/small", "space/small/objects.csv"])
def test_what_may_not_be_read_is_one_line(closed):
    with tempfile.TemporaryDirectory() as home:
        Path(home).chmod(0o755)
        folder = write_space(Path(home) / "space", small_space())
        (Path(home) / closed).chmod(0)
        assert as_nobody(lambda: load_labels(str(folder))) == 0


def as_nobody(read):
    """0 where reading, in a child that may read little, ends in one line."""
    child = os.fork()
    if not child:
        os.setuid(65534)
        try:
            read()
        except InputError as error:
            os._exit(0 if "\n" not in str(error) else 3)
        except BaseException:
            os._exit(2)
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_written_name_wins_over_a_derived_one():
    objects = (ObjectLabel("glass", "glasses"), ObjectLabel("glasses", "glasses"))
    space = LabelSpace("x", objects, (RoomLabel("office", "an"),))
    assert space.object_aliases["glasses"] == "glasses"


def test_an_unknown_name_lists_the_builtin_ones():
    with pytest.raises(LabelSpaceError, match="mpcat40, nyuclass"):
        load_labels("nowhere")
