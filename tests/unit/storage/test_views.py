"""Views and macros against the lookup's own arithmetic, and what may not be done."""

import json
import logging
from datetime import datetime, timezone

import pytest

from roomtables import RoomTables, build
from roomtables.config import pipeline_folder
from roomtables.errors import InputError, StoreError
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.versions import SpaceFolder
from roomtables.storage.views import connect, select
from sql_fixtures import save_evaluation
from tiny_tables import (
    OBJECTS,
    ROOMS,
    FitScorer,
    build_tables,
    change_tables,
    write_labels,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sql")
    counts = folder / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,9\noven,kitchen,4\nchair,office,1\n")
    labels = str(write_labels(folder))
    # Without smoothing: an unseen object says nothing, a seen one rules rooms out for good.
    build(
        tables=folder / "t", scorer=FitScorer(), labels=labels, counts=counts, smoothing=0,
        rule="calibrated", prior_weight=1.0, evidence_power=1.0, k=2,
    )  # fmt: skip
    return folder / "t"


@pytest.fixture(scope="module")
def tables(folder):
    return RoomTables.open(folder, "flat", offline=True)


@pytest.fixture
def connection(folder, tables):
    connection = connect(folder, tables.version)
    yield connection
    connection.close()


@pytest.mark.parametrize("source", ["proxy", "ground_truth"])
@pytest.mark.parametrize(("prior_weight", "evidence_power"), [(0, 0), (0.5, 3), (1, 1)])
@pytest.mark.parametrize("objects", [["bed"], ["chair", "lamp"], ["bed", "oven"], list(OBJECTS)])
def test_p_room_given_is_rule_pooled(
    connection, tables, objects, source, prior_weight, evidence_power
):
    rule = tables.deciding(
        rule="pooled", source=source, prior_weight=prior_weight, evidence_power=evidence_power
    )
    _, rows = select(
        connection,
        f"from p_room_given({objects}, from_source := '{source}', "
        f"prior_weight := {prior_weight}, evidence_power := {evidence_power})",
    )
    expected = rule.classify(objects)
    assert rows[0][0] == expected.room
    assert {room: p for room, _, p, *_ in rows} == pytest.approx(expected.probabilities, abs=1e-12)


def test_picked_and_answers_are_rule_query(connection, tables):
    expected = tables.deciding(rule="query").classify(list(OBJECTS))
    _, rows = select(connection, f"from picked({list(OBJECTS)})")
    assert [row[1] for row in rows] == list(expected.objects)
    for given in (list(OBJECTS), sorted(expected.objects), [*OBJECTS, "unicorn"]):
        _, rows = select(connection, f"from answers({given})")
        assert {row[0]: row[2] for row in rows} == pytest.approx(expected.probabilities, abs=1e-9)
    assert select(connection, "from answers(['unicorn'])")[1] == [(None, None, None, ["unicorn"])]


def test_the_manifest_says_how_to_decide(connection):
    columns, rows = select(connection, "from decision")
    published = {"source": "proxy", "rule": "calibrated", "prior_weight": 1.0, "k": 2}
    assert dict(zip(columns, rows[0], strict=True)) == published | {"evidence_power": 1.0}


@pytest.mark.parametrize(
    ("macro", "more", "changes"),
    [
        ("decided", "", {}),
        ("calibrated", "", {}),
        ("calibrated", ", prior_weight := 0.25", {"prior_weight": 0.25}),
        ("p_room_given", "", {"rule": "pooled"}),
        ("decided", ", by_rule := 'pooled'", {"rule": "pooled"}),
        ("decided", ", by_rule := 'query'", {"rule": "query"}),
        ("decided", ", from_source := 'ground_truth'", {"source": "ground_truth"}),
        ("decided", ", among := ['office', 'kitchen']", {"rooms": ("office", "kitchen")}),
    ],
)
def test_macros_go_by_the_manifest_where_nothing_else_is_said(
    connection, tables, macro, more, changes
):
    objects = ["oven", "chair", "bed"]
    expected = tables.deciding(**changes).classify(objects)
    _, rows = select(connection, f"from {macro}({objects}{more})")
    assert rows[0][0] == expected.room
    assert {room: p for room, _, p, *_ in rows} == pytest.approx(expected.probabilities, abs=1e-9)


def test_macros_take_every_name_and_say_what_they_could_not_read(connection, tables):
    given = ["BEDS", "stove", " Oven", "lmap", "unicorn", ""]
    expected = tables.deciding(rule="pooled").classify(["bed", "oven"])
    for macro in ("p_room_given", "decided", "answers", "calibrated", "picked"):
        columns, rows = select(connection, f"from {macro}({given})")
        assert columns[-1] == "unknown_objects"
        assert {tuple(row[-1]) for row in rows} == {("lmap", "unicorn")}
    _, rows = select(connection, f"from p_room_given({given})")
    assert {row[0]: row[2] for row in rows} == pytest.approx(expected.probabilities, abs=1e-12)
    assert select(connection, f"from read_names({given[:5]})")[1] == [
        ("BEDS", "bed", "plural", None),
        ("stove", "oven", "synonym", None),
        (" Oven", "oven", "label", None),
        ("lmap", None, None, "lamp"),
        ("unicorn", None, None, None),
    ]


@pytest.mark.parametrize("macro", ["decided", "answers", "calibrated", "p_room_given", "picked"])
def test_a_room_of_unknown_names_is_one_row_without_an_answer(connection, macro):
    _, (row,) = select(connection, f"from {macro}(['toilte', 'snk'])")
    assert set(row[:-1]) == {None}
    assert row[-1] == ["snk", "toilte"]
    assert select(connection, f"from {macro}([])")[1] == []
    assert select(connection, f"from {macro}(['bed'], from_source := 'nobody')")[1] == []


def test_what_the_tables_lack_is_decided_by_rule_pooled(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text('{"room_id": "1", "objects": ["bed", "lamp"]}\n')
    folder = build_tables(tmp_path, str(log))
    tables = RoomTables.open(folder, "flat", offline=True, note_misses=False)
    connection = connect(folder, tables.version)
    for objects, rule in ((["bed", "lamp"], "query"), (["oven", "chair"], "pooled")):
        expected = tables.classify(objects)
        _, rows = select(connection, f"from decided({objects})")
        assert expected.rule == rule
        assert {row[3] for row in rows} == {rule}
        assert {row[0]: row[2] for row in rows} == pytest.approx(expected.probabilities, abs=1e-9)
    assert select(connection, "from decided(['oven', 'chair'], backoff := false)")[1] == []
    connection.close()


def test_fewer_objects_may_be_picked_than_the_sentences_name(connection, tables):
    ((_, best, *_),) = select(connection, f"from picked({list(OBJECTS)}, k := 1)")[1]
    expected = tables.deciding(rule="query").classify([best])
    _, rows = select(connection, f"from answers({list(OBJECTS)}, k := 1)")
    assert {room: p for room, _, p, *_ in rows} == pytest.approx(expected.probabilities, abs=1e-9)


def test_informative_objects_and_signatures(connection):
    _, rows = select(connection, "from informative_objects where source = 'ground_truth'")
    best = {row[2]: row[5] for row in rows}
    assert (best["bed"], best["oven"]) == ("bedroom", "kitchen")
    _, rows = select(
        connection, "from room_signatures where source = 'proxy' and rank = 1 order by room"
    )
    assert [row[1] for row in rows] == sorted(ROOMS)
    _, rows = select(
        connection,
        "select source, room, avg(lift_nats) from room_signatures "
        "where source = 'proxy' group by all",
    )
    assert [row[2] for row in rows] == pytest.approx([0] * len(rows), abs=1e-9)


def test_every_view_and_macro_is_described(connection):
    files = [p for kind in ("views", "macros") for p in (pipeline_folder() / kind).glob("*.sql")]
    described = {name.split("(")[0]: holds for name, holds in select(connection, "from guide")[1]}
    assert {path.stem for path in files} <= described.keys()
    assert all(described.values())
    for path in (pipeline_folder() / "views").glob("*.sql"):
        assert path.read_text().startswith("-- One row per ")


@pytest.mark.parametrize(
    "query",
    [
        "drop view evidence",
        "create table x as select 1",
        "select 1; select 2",
        "copy entropy to 'x.csv'",
        "select * from read_csv('/etc/passwd')",
        "set threads = 3",
        "attach 'x.duckdb'",
        "select nonsense",
        "with gone as (delete from noted_misses returning *) select * from gone",
        "with new as (insert into noted_misses (source) values ('x') returning *) from new",
        "select count(*) from glob('/etc/*')",
        "",
    ],
)
def test_what_does_not_only_read_the_tables_is_refused(connection, query):
    with pytest.raises(InputError, match="SQL"):
        select(connection, query)


def test_times_with_a_zone_need_no_other_package(connection):
    columns, rows = select(
        connection,
        "select timestamptz '2026-01-02 03:04:05+02' as moment, "
        "[timestamptz '2026-01-02 03:04:05Z'] as moments, 'x' as moment, now() > '2020-01-01' as a",
    )
    assert columns == ["moment", "moments", "moment", "a"]
    assert rows == [
        (
            datetime(2026, 1, 2, 1, 4, 5, tzinfo=timezone.utc),
            [datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)],
            "x",
            True,
        )
    ]
    with pytest.raises(InputError, match="cast the column to varchar"):
        select(connection, "select 'infinity'::timestamptz")


def test_one_column_per_room(connection):
    _, rows = select(
        connection,
        'select object, "kitchen" - "office" from p_room_by_object where source = \'proxy\'',
    )
    long = dict(select(
        connection,
        "select object, sum(case room when 'kitchen' then p_room_given_object "
        "when 'office' then -p_room_given_object else 0 end) "
        "from cooccurrence where source = 'proxy' group by object",
    )[1])  # fmt: skip
    assert dict(rows) == pytest.approx(long, abs=1e-12)
    _, ((margin,),) = select(
        connection,
        'select "kitchen" - "office" from query_scores '
        "where source = 'proxy' and objects = ['oven']",
    )
    _, rows = select(connection, "from answers(['oven'], from_source := 'proxy')")
    scores = {row[0]: row[1] for row in rows}
    assert margin == pytest.approx(scores["kitchen"] - scores["office"], abs=1e-6)


@pytest.mark.parametrize("rule", ["query", "calibrated"])
def test_answers_by_combination_are_those_of_the_lookup(connection, tables, rule):
    _, rows = select(
        connection,
        "select objects, room, p_room, second_room, second_p_room, margin_nats "
        f"from answers_by_combination where source = 'proxy' and rule = '{rule}'",
    )
    decides = tables.deciding(rule=rule)
    assert len(rows) == 15  # of one or two of five objects
    for objects, room, p, second, second_p, margin in rows:
        expected = decides.classify(objects)
        best = sorted(expected.probabilities.items(), key=lambda found: (-found[1], found[0]))
        assert [room, second] == [name for name, _ in best[:2]]
        assert [p, second_p] == pytest.approx([value for _, value in best[:2]], abs=1e-9)
        nats = sorted(expected.compared.tolist())
        assert margin == pytest.approx(nats[-1] - nats[-2], abs=1e-9)


def test_versions_and_what_changed_between_any_two(tmp_path):
    """Against the rooms that a lookup of each version answers."""
    labels = str(write_labels(tmp_path))
    spaces = SpaceFolder(tmp_path / "tables", "flat")
    answers = {}
    for reduction, wanted in (("sum", "all"), ("mean", "all")):
        build(
            tables=tmp_path / "tables", labels=labels, scorer=FitScorer(), reduction=reduction,
            combinations=wanted, k=2,
        )  # fmt: skip
        opened = RoomTables.open(tmp_path / "tables", "flat", offline=True, note_misses=False)
        answers[opened.version.name] = opened
    with connect(tmp_path / "tables", spaces.current()) as connection:
        _, rows = select(
            connection, "select version, reduction, published, k from versions order by 1"
        )
        old, new = sorted(answers)
        assert rows == [(old, "sum", False, 2), (new, "mean", True, 2)]
        for before, after in ((old, new), (new, old)):
            _, rows = select(
                connection,
                "select objects, room_before, room_after, p_before, p_after from version_changes "
                f"where before = '{before}' and after = '{after}' and kind = 'combination'",
            )
            assert len(rows) == 15
            for objects, *found in rows:
                pair = [answers[name].classify(objects) for name in (before, after)]
                assert found[:2] == [one.room for one in pair]
                assert found[2:] == pytest.approx([one.probability for one in pair], abs=1e-9)
        _, rows = select(
            connection,
            "select objects[1], entropy_before, entropy_after, p_after from version_changes "
            f"where kind = 'object' and before = '{old}'",
        )
        assert {row[0] for row in rows} == set(OBJECTS)
        entropies = dict(select(connection, "select object, entropy_nats from entropy")[1])
        assert {row[0]: row[2] for row in rows} == pytest.approx(entropies, abs=1e-12)


def test_a_damaged_version_that_is_not_published_is_left_out(tmp_path, caplog):
    build_tables(tmp_path)
    change_tables(tmp_path)
    space = SpaceFolder(tmp_path / "tables", "flat")
    older = space.versions()[0]
    (older / "entropy.parquet").write_bytes(b"half")
    with (
        caplog.at_level(logging.WARNING),
        connect(tmp_path / "tables", space.current()) as connection,
    ):
        found = select(connection, "select version from versions")[1]
        assert found == [(space.current().name,)]
    assert f"{older / 'entropy.parquet'} is damaged" in caplog.text


def test_confusion_of_saved_evaluations(tmp_path, caplog):
    folder = build_tables(tmp_path)
    version = SpaceFolder(folder, "flat").current()
    with connect(folder, version) as connection:
        assert select(connection, "from confusion")[1] == []
    rooms = [("1", "kitchen", "kitchen"), ("2", "kitchen", "office"), ("3", "kitchen", "office"),
             ("4", "office", None)]  # fmt: skip
    save_evaluation(version, "Monday's", rooms)
    save_evaluation(version, "tuesday", rooms[:1])
    (folder / "flat" / "evaluations" / "broken.parquet").write_bytes(b"PAR1 not")
    with caplog.at_level(logging.WARNING), connect(folder, version) as connection:
        _, found = select(
            connection,
            "select evaluation, room, predicted, rooms from confusion order by all nulls first",
        )
    assert found == [
        ("Monday's", "kitchen", "kitchen", 1),
        ("Monday's", "kitchen", "office", 2),
        ("Monday's", "office", None, 1),
        ("tuesday", "kitchen", "kitchen", 1),
    ]
    assert "broken.parquet is left out" in caplog.text


def test_miss_coverage_says_what_is_answered_now(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text('{"room_id": "1", "objects": ["bed", "lamp"]}\n')
    folder = build_tables(tmp_path, str(log))
    noted = folder / "flat" / FOLDER
    noted.mkdir()
    lines = [
        {"source": "proxy", "objects": objects, "asked": f"2026-01-0{day}T00:00:00+00:00"}
        for day, objects in ((1, ["oven", "chair"]), (2, ["oven", "chair"]), (3, ["lamp", "bed"]))
    ]
    (noted / "robot.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    query = "select objects, times_asked, last_asked, taken_in, answered from miss_coverage"
    order = " order by times_asked desc"
    version = SpaceFolder(folder, "flat").current()
    with connect(folder, version) as connection:
        assert select(connection, query + order)[1] == [
            (["oven", "chair"], 2, datetime(2026, 1, 2), False, False),
            (["lamp", "bed"], 1, datetime(2026, 1, 3), False, True),
        ]
        assert len(select(connection, "from misses")[1]) == 2
    build(tables=folder, labels=str(tmp_path / "flat"), scorer=FitScorer(), combinations="misses")
    with connect(folder, SpaceFolder(folder, "flat").current()) as connection:
        _, rows = select(connection, query + " order by objects[1]")
        assert rows == [
            (["lamp", "bed"], None, None, True, True),
            (["oven", "chair"], None, None, True, True),
        ]
        assert select(connection, "from misses")[1] == []


def test_names_of_rooms_and_objects_may_hold_anything(tmp_path):
    rooms = ['the "den"', "o'clock room", "a;b -- c", "object", "größe 部屋", "p_room", "rooms"]
    labels = tmp_path / 'it\'s {0} "odd"'
    labels.mkdir()
    (labels / "objects.csv").write_text('object\nman\'s "thing"\nlamp\n', encoding="utf-8")
    (labels / "rooms.csv").write_text(
        "room\n" + "".join(f"{_csv(room)}\n" for room in rooms), encoding="utf-8"
    )
    for k in (1, 2):
        build(
            tables=tmp_path / "t", labels=str(labels), scorer=FitScorer(), k=k, combinations="all"
        )
    version = SpaceFolder(tmp_path / "t", labels.name).current()
    with connect(tmp_path / "t", version) as connection:
        _, found = select(connection, "from guide")
        for name in (name for name, _ in found if "(" not in name):
            select(connection, f"from {name}")
        columns, rows = select(connection, "from p_room_by_object")
        assert len(columns) == 2 + len(rooms)
        assert sum(rows[0][2:]) == pytest.approx(1)
        _, rows = select(
            connection, "from decided(['man''s \"thing\"'], among := ['o''clock room', 'object'])"
        )
        assert {row[0] for row in rows} == {"o'clock room", "object"}


def _csv(name):
    return '"' + name.replace('"', '""') + '"'


def _cut(content):
    return content[:-1]


def _flip(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("damage", [_cut, _flip, lambda content: b""])
@pytest.mark.parametrize("name", ["objects", "names", "cooccurrence", "entropy", "query_scores"])
def test_a_damaged_table_is_one_clear_line(tmp_path, name, damage):
    folder = build_tables(tmp_path)
    version = SpaceFolder(folder, "flat").current()
    path = version.path / f"{name}.parquet"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(StoreError, match=rf"{name}\.parquet is damaged; run `roomtables build`"):
        connect(folder, version)
    path.unlink()
    with pytest.raises(StoreError, match=rf"{name}\.parquet is damaged"):
        connect(folder, version)
