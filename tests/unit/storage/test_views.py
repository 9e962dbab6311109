"""Views and macros against the lookup's own arithmetic, the prompt, and what may not be done."""

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from roomtables import RoomTables, build
from roomtables.cli import exploring, main
from roomtables.config import pipeline_folder
from roomtables.errors import InputError
from roomtables.storage.views import connect, guide, select
from tiny_tables import OBJECTS, ROOMS, FitScorer, build_tables, write_labels


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
    assert select(connection, "from answers(['unicorn'])")[1] == []


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


def test_a_room_of_unknown_names_is_one_row_without_an_answer(connection):
    _, rows = select(connection, "from decided(['toilte', 'snk'])")
    assert rows == [(None, None, None, None, ["snk", "toilte"])]
    assert select(connection, "from decided([])")[1] == []


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
    described = {row["name"].split("(")[0]: row["holds"] for row in guide(connection)}
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
        "",
    ],
)
def test_what_does_not_only_read_the_tables_is_refused(connection, query):
    with pytest.raises(InputError, match="SQL"):
        select(connection, query)


def run(folder, *arguments, stdin=None):
    command = ["sql", "--tables", str(folder), "--labels", "flat", *arguments]
    return CliRunner().invoke(main, command, input=stdin)


def test_queries_from_a_pipe(folder):
    found = run(folder, "--format", "csv", stdin="select 1 as a;\n\nselect\n2 as b")
    assert found.stdout == "a\n1\nb\n2\n"
    found = run(folder, stdin="select 1 as a;\nselect nonsense;\nselect 2;")
    assert found.exit_code == 1
    assert "nonsense" in found.stderr
    assert "p_room_given(" in run(folder, stdin=".tables\n.quit\nselect nonsense;").stdout


def test_a_prompt_survives_errors(folder, monkeypatch):
    lines = iter(["selec 1;", "select 41 + 1", "as answer;", ".quit"])
    asked = []

    def read(prompt):
        asked.append(prompt)
        return next(lines)

    monkeypatch.setattr(exploring.sys, "stdin", type("Tty", (), {"isatty": lambda self: True})())
    monkeypatch.setattr("builtins.input", read)
    shown = []
    monkeypatch.setattr(exploring.click, "echo", lambda text="", **_: shown.append(str(text)))
    with exploring.click.Context(exploring.sql_command):
        exploring.sql_command.callback(None, folder, "flat", False, "table", None)
    assert any(text.startswith("error: SQL") for text in shown)
    assert any("42" in text for text in shown)
    assert asked == ["roomtables> ", "roomtables> ", "       ...> ", "roomtables> "]


def test_ui_without_harlequin_says_what_to_install(folder, monkeypatch):
    monkeypatch.setattr(exploring, "find_spec", lambda name: None)
    found = run(folder, "--ui")
    assert found.exit_code == 1
    assert "pip install 'roomtables[ui]'" in found.stderr
    assert run(folder, "--ui", "select 1").exit_code == 2


def test_ui_hands_over_a_database_with_every_view(folder, monkeypatch):
    """What harlequin is started on can be read by another process, read-only."""
    read = (
        "import duckdb, json, sys; c = duckdb.connect(sys.argv[1], read_only=True); "
        "print(json.dumps(c.execute('select count(*) from entropy').fetchall()), "
        "len(c.execute(\"from p_room_given(['bed'])\").fetchall()))"
    )
    outputs = []

    def start(command, check):
        outputs.append(subprocess.check_output([sys.executable, "-c", read, command[-1]]))

    monkeypatch.setattr(exploring, "find_spec", lambda name: object())
    monkeypatch.setattr(exploring, "subprocess", SimpleNamespace(run=start))
    assert run(folder, "--ui").exit_code == 0
    assert outputs[0].decode().split() == [json.dumps([[2 * len(OBJECTS)]]), str(len(ROOMS))]
