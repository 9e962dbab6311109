"""What the readers of JSON and YAML refuse, and that no other module reads them by itself."""

import ast
import time
from pathlib import Path

import pytest

from roomtables.limits import MalformedError, json_value, yaml_value

PACKAGE = Path(__file__).parents[2] / "src" / "roomtables"
READERS = {"json": {"load", "loads", "JSONDecoder"}, "csv": {"reader", "DictReader"},
           "yaml": None, "tomllib": None, "tomli": None, "pickle": None,
           "marshal": None}  # fmt: skip
# Who may: the limits' own home, CSV's, the settings, whose TOML is the user's own file, and the
# list of inflected names, which the package brings.
ALLOWED = {
    "limits.py": {"json", "yaml"},
    "csv_rows.py": {"csv"},
    "config.py": {"tomllib", "tomli"},
    "english.py": {"csv"},
}


def read_by_itself(tree):
    """Each module of a format that a syntax tree reads with, and the function it calls."""
    for found in ast.walk(tree):
        match found:
            case ast.Attribute(value=ast.Name(id=module), attr=name) if module in READERS:
                names = READERS[module]
                if names is None or name in names:
                    yield module, name
            case ast.ImportFrom(module=module, names=names) if module in READERS:
                for name in names:
                    wanted = READERS[module]
                    if wanted is None or name.name in wanted:
                        yield module, name.name


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: path.stem)
def test_every_parser_reads_through_the_limits(path):
    allowed = ALLOWED.get(str(path.relative_to(PACKAGE)), set())
    found = [call for call in read_by_itself(ast.parse(path.read_text())) if call[0] not in allowed]
    assert not found, "read it with roomtables.limits or roomtables.csv_rows"


@pytest.mark.parametrize(
    "code",
    ["json.loads(x)", "from json import loads", "yaml.safe_load(x)", "csv.reader(x)",
     "import json\ndef f(): return json.load(x)"],
)  # fmt: skip
def test_a_parser_of_its_own_is_found(code):
    assert list(read_by_itself(ast.parse(code)))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("1" * 5000, "more than 20 digits"),
        ('{"a": -' + "9" * 21 + "}", "more than 20 digits"),
        ("[" * 101 + "]" * 101, "nested more than 100 deep"),
        ('{"a":' * 50_000, "nested more than 100 deep"),
        ("[NaN]", "NaN"),
        ("-Infinity", "-Infinity"),
        ('"\\ud800"', "surrogate"),
        ('{"\\udfff": 1}', "surrogate"),
        ("\ud800", "surrogate"),
        (b"\xff", "not UTF-8"),
        ("[1,\n 2", "Expecting"),
        ("", "Expecting"),
    ],
)
def test_what_json_is_refused(content, said):
    with pytest.raises(MalformedError, match=said):
        json_value(content)


def test_what_json_passes():
    assert json_value("[" * 100 + "]" * 100)
    assert json_value(b"\xef\xbb\xbf[18446744073709551615, 1e999]") == [2**64 - 1, float("inf")]
    assert json_value('"\\ud83d\\ude00"') == "😀"
    assert json_value("[1" + "0" * 30 + ", Infinity]", any_number=True) == [10**30, float("inf")]
    assert json_value("1." + "0" * 500) == 1.0


MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}\n" for n in range(1, 10)
)
ALIASES = MERGES.replace("{<<: [", "[").replace("]}", "]")


@pytest.mark.parametrize(
    ("content", "said", "line"),
    [
        (MERGES, "'merge' is no plain value", 2),
        (ALIASES, "aliases counted", None),
        ("a: &a [*a]", "an alias of what it stands in", 1),
        ("x: 1\ny: 2001-99-99", "'2001-99-99' is no timestamp", 2),
        ("!!int x", "'x' is no int", 1),
        ("!!float y", "'y' is no float", 1),
        ("!!int ''", "is no int", 1),
        ("!!python/object/apply:os.system [ls]", "is no plain value", 1),
        ("!!set {a}", "'set' is no plain value", 1),
        ("x: " + "9" * 5000, "is no int|beyond 64 bits", 1),
        ("1:" * 300 + "1", "beyond 64 bits", 1),
        ("[" * 5000, "nested more than 100 deep", None),
        ("a: [", "expected the node content", 1),
        ("\x00", "unacceptable character", None),
        ('a: b\nc: "\\ud800"', "surrogate", 2),
        ('{"\\udfff": 1}', "surrogate", 1),
        ("x: " + "y" * 20_000, "more than 10000 characters", 1),
        ("x" * 600_000, "larger than 512 kB", None),
    ],
)
def test_what_yaml_is_refused_at_once(content, said, line):
    pytest.importorskip("yaml")
    started = time.process_time()
    with pytest.raises(MalformedError, match=said) as caught:
        yaml_value(content.encode())
    assert time.process_time() - started < 10
    assert line is None or caught.value.line == line
    assert "\n" not in str(caught.value)


def test_what_yaml_passes():
    pytest.importorskip("yaml")
    assert yaml_value(b"a: [1, x, 2.5, null, true]\nb: &b {c: d}\ne: *b") == {
        "a": [1, "x", 2.5, None, True], "b": {"c": "d"}, "e": {"c": "d"},
    }  # fmt: skip
    assert yaml_value(b"") is None
