"""Whatever a file holds, a parser reads it or says what is wrong in one line: never a traceback."""

import json
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from roomtables.config import BuildConfig
from roomtables.csv_rows import read_csv
from roomtables.errors import RoomtablesError
from roomtables.labels import LabelSpace
from roomtables.offline.inputs import read_counts, read_scores
from roomtables.rooms import read_room_lines
from roomtables.storage.versions import SpaceFolder, Version
from support import small_space

SPACE = small_space()
fuzz = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

# Bytes that are nothing, text that is nearly CSV, and values that are nearly right.
cell = st.sampled_from(
    [
        "bed",
        "bedroom",
        "sink",
        "kitchen",
        "1",
        "-1",
        "nan",
        "inf",
        "1e999",
        "",
        " ",
        '"',
        "'",
        "a|b",
        "true",
        "false",
        "maybe",
        "\x00",
        "\ufeff",
        "é",
        "🛁",
        "x" * 200,
        "9" * 400,
    ]
) | st.text(max_size=8)
header = st.sampled_from(
    [
        "object,room,count",
        "object,room,log_prob",
        "object,room,mean_log_prob,token_count",
        "object,plural,synonyms",
        "room,article,synonyms,predicted",
        "object",
        "room",
        "room,room",
        "",
        ",",
    ]
)
row = st.lists(cell, max_size=5).map(",".join)
csv_text = st.builds(lambda h, rows: "\n".join([h, *rows]).encode("utf-8", "replace"), header,
                     st.lists(row, max_size=6))  # fmt: skip
csv_bytes = st.binary(max_size=200) | csv_text | csv_text.map(lambda text: text[:-3] + b"\xff")

scalar = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6)
value = st.recursive(scalar, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
    st.sampled_from(["room_id", "room", "objects", "x"]), inner, max_size=4), max_leaves=8
)  # fmt: skip
line = (
    st.builds(lambda v: json.dumps(v).encode(), value)
    | st.binary(max_size=40)
    | st.sampled_from([b"", b"{", b"[" * 3000, b"1" * 5000, b'{"room_id": 1e999}', b"\xff\xfe{}"])
)
json_lines = st.lists(line, max_size=5).map(b"\n".join)


def survives(parse):
    """Run a parser: it succeeds, or raises an error of ours."""
    with suppress(RoomtablesError):
        parse()


@fuzz
@given(csv_bytes)
@example(b"object,room,count\n" + b"9" * 140_000)
@example(b"\xff\xfeo\x00")
def test_csv(tmp_path, content):
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    survives(lambda: list(read_csv(path, ("object",))))
    survives(lambda: read_counts(path, SPACE))
    survives(lambda: read_scores(path, SPACE, "sum"))
    survives(lambda: read_scores(path, SPACE, "mean"))


@fuzz
@given(csv_bytes, csv_bytes)
def test_label_folders(tmp_path, objects, rooms):
    (tmp_path / "objects.csv").write_bytes(objects)
    (tmp_path / "rooms.csv").write_bytes(rooms)

    def parse():
        space = LabelSpace.load(tmp_path)
        assert space.objects
        assert space.predicted_rooms
        assert all(label.label and label.plural for label in space.objects)

    survives(parse)


@fuzz
@given(json_lines)
def test_room_lines(tmp_path, content):
    path = tmp_path / "rooms.jsonl"
    path.write_bytes(content)
    survives(lambda: list(read_room_lines(path)))
    survives(lambda: read_counts(path, SPACE))


keys = st.sampled_from([*BuildConfig.__dataclass_fields__, "x", "a.b"])
toml_value = st.sampled_from(
    [
        "1",
        "-1",
        "3",
        "0.5",
        "nan",
        "inf",
        "true",
        '"mpcat40"',
        '"mean"',
        "[]",
        '["objects"]',
        '"a{objects}b{room}"',
        '"{"',
        "1979-05-27",
        "{}",
        "9" * 30,
        "9" * 5000,
        "[1, [2]]",
        "'''x'''",
    ]
)
toml = st.lists(st.builds("{} = {}".format, keys, toml_value), max_size=4).map("\n".join)


@fuzz
@given(st.binary(max_size=100) | toml.map(str.encode))
def test_toml(tmp_path, content):
    path = tmp_path / "build.toml"
    path.write_bytes(content)
    survives(lambda: BuildConfig.load(path))


noted = st.dictionaries(
    st.sampled_from(["schema_version", "created", "files", "stages"]), value, max_size=4
)
manifest = (
    st.binary(max_size=60)
    | value.map(lambda v: json.dumps(v).encode())
    | noted.map(lambda v: json.dumps({"schema_version": 2, **v}).encode())
)
pointer = st.binary(max_size=60) | st.sampled_from([b"v", b"v\n", b"../x", b".", b"\x00"])


@fuzz
@given(pointer, manifest)
def test_pointers_and_manifests(tmp_path, name, content):
    folder = tmp_path / "home"
    (folder / "v").mkdir(parents=True, exist_ok=True)
    (folder / "v" / "manifest.json").write_bytes(content)
    (folder / "CURRENT").write_bytes(name)
    survives(lambda: SpaceFolder(tmp_path, "home").current())
    survives(lambda: Version.open(folder / "v"))


@pytest.mark.parametrize("parse", [read_csv, read_counts, read_scores])
def test_a_folder_or_nothing_instead_of_a_file(tmp_path, parse):
    more = {read_csv: (("object",),), read_counts: (SPACE,), read_scores: (SPACE, "sum")}[parse]
    for path in (tmp_path, tmp_path / "absent.csv"):
        with pytest.raises(RoomtablesError, match="cannot read"):
            list(parse(path, *more))
