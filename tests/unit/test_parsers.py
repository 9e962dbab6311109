"""Whatever a file holds, a parser reads it or says what is wrong in one line: never a traceback.

Each target takes valid input that was made wrong (`mutations`) and reads it. `make test` draws a
hundred inputs a target; `make test-faults` thousands, or as many as ROOMTABLES_FUZZ says.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from mutations import as_json, changed_bytes, changed_cells, changed_value
from roomtables import build
from roomtables.config import BuildConfig
from roomtables.csv_rows import read_csv
from roomtables.errors import RoomtablesError, StoreError
from roomtables.labels import LabelSpace
from roomtables.lm.folders import resolve
from roomtables.lm.identity import scorer_id, scoring_kind
from roomtables.offline.inputs import read_counts, read_scores
from roomtables.rooms import read_room_lines
from roomtables.scenes.hydra import read_hydra_labels
from roomtables.scenes.matterport_labels import object_namer
from roomtables.scenes.reader import read_scene
from roomtables.scenes.scene import ReadOptions
from roomtables.storage.lookup import Lookup
from roomtables.storage.misses import Misses
from roomtables.storage.versions import CURRENT, MANIFEST, SpaceFolder, Version
from scene_builders import House, box, graph, node
from support import HashScorer, small_space, write_space

SPACE = small_space()
Make = Callable[[Random], bytes]
LONG = int(os.environ.get("ROOMTABLES_FUZZ", "3000"))
MOST_SECONDS, MOST_KILOBYTES = 10.0, 300_000  # of one input

ROOM = {"room_id": "a", "room": "bedroom;kitchen", "objects": ["bed", "lamp"], "counts": [1, 2]}
NESTED = {
    "rooms": [
        {"id": "R0", "name": "x", "room": "kitchen",
         "objects": [{"id": 1, "name": "sink", "position": [1, 2, 3]}, "bed"]},
    ],
    "unassigned": [{"id": "O9", "name": "lamp"}],
}  # fmt: skip
GRAPH = graph(
    [node("R0", 1, bounding_box=box((0, 0, 0), (4, 4, 3))), node("p0"), node("O0", 1),
     node("O1", 2)],
    [("R0", "p0"), ("p0", "O0"), ("p0", "O1"), ("R0", "O1")],
    labels={1: "bed", 2: "lamp"},
    rooms={1: "bedroom"},
)  # fmt: skip
HYDRA = {
    "total_semantic_labels": 3,
    "dynamic_labels": [],
    "object_labels": [1, 2],
    "label_names": [{"label": 0, "name": "wall"}, {"label": 1, "name": "bed"},
                    {"label": 2, "name": "sink"}],
}  # fmt: skip
COUNTS = ["object,room,count", "bed,bedroom,3", "sink,kitchen,4"]
SCORES = ["object,room,log_prob"] + [
    f"{o.label},{r.label},-{at}.5" for at, o in enumerate(SPACE.objects) for r in SPACE.rooms
]
MEANS = ["object,room,mean_log_prob,token_count"] + [line + ",7" for line in SCORES[1:]]
OBJECTS = ["object,plural,synonyms", "bed,beds,cot|crib", "sink,,basin"]
ROOMS = ["room,article,synonyms,predicted", "bedroom,a,,true", "yard,a,garden,false"]
TOML = ['labels = "mpcat40"', "k = 3", 'rule = "query"', "prior_weight = 0.5",
        "smoothing = 1.0", 'template = "A room with {objects} is called {room}."', "[stages]",
        'lookup = ["entropy"]']  # fmt: skip
MISS = {"source": "proxy", "objects": ["bed", "sink"], "asked": "2026-01-01T00:00:00+00:00"}
TAKEN = {"read": {"robot-1.jsonl": 5}, "combinations": [["proxy", "bed", "sink"]]}
CONFIG = {"architectures": ["GPT2LMHeadModel"], "model_type": "gpt2", "n_layer": 2}
INDEX = {"metadata": {}, "weight_map": {"a": "model-1.safetensors", "b": "model-2.safetensors"}}
HM3D = ["HM3D Semantic Annotations", '1,A1B2C3,"bed, double",0', '2,A1B2C4,"sink",-1']
MAPPING = ["index\tcategory\tnyuClass", "1\tbed\tbed", "2\tsink\tsink"]


def house_lines() -> list[str]:
    house = House()
    region = house.region("b", (0, 0, 0), (4, 4, 3))
    house.object(region, house.category("bed", "bed"), (1, 1, 1))
    house.object(-1, -1, (9, 9, 9))
    return house.text().splitlines()


def of_value(value: object) -> Callable[[Random], bytes]:
    """Input from a JSON value: changed as a value, or its bytes."""

    def make(random: Random) -> bytes:
        if random.random() < 0.3:
            return changed_bytes(as_json(value), random)
        return as_json(changed_value(value, random))

    return make


def of_lines(lines: list[str], separator: str | None = ",") -> Callable[[Random], bytes]:
    """Input from lines of cells: cells changed, or bytes."""

    def make(random: Random) -> bytes:
        if random.random() < 0.3:
            return changed_bytes("\n".join(lines).encode(), random)
        return changed_cells(lines, separator, random)

    return make


def of_json_lines(value: object) -> Callable[[Random], bytes]:
    one = of_value(value)
    return lambda random: b"\n".join([as_json(value), one(random), one(random)]) + b"\n"


def yaml_bytes(random: Random) -> bytes:
    yaml = pytest.importorskip("yaml")
    if random.random() < 0.5:
        return changed_bytes(yaml.safe_dump(HYDRA).encode(), random)
    return as_json(changed_value(HYDRA, random))  # which is YAML as well, where it is JSON


def scene(path: Path, **options: object) -> None:
    """Read a scene to its end, and write down what was read."""
    found = read_scene(path, ReadOptions(**options))
    for room in found.rooms:
        json.dumps([room.as_json(), room.as_room().as_json()], ensure_ascii=False).encode()


def scene_target(name: str, **options: object) -> Callable[[Path, bytes], None]:
    def parse(folder: Path, content: bytes) -> None:
        (folder / name).write_bytes(content)
        scene(folder / name, **options)

    return parse


def file_target(name: str, *readers: Callable[[Path], object]) -> Callable[[Path, bytes], None]:
    def parse(folder: Path, content: bytes) -> None:
        (folder / name).write_bytes(content)
        for read in readers:
            try:
                read(folder / name)
            except RoomtablesError:
                if read is readers[-1]:
                    raise

    return parse


def hovsg(folder: Path, content: bytes) -> None:
    for name in ("rooms", "objects"):
        (folder / name).mkdir(exist_ok=True)
    room, thing = content[: len(content) // 2], content[len(content) // 2 :]
    (folder / "rooms" / "0.json").write_bytes(room if thing[:1] == b"\n" else content)
    (folder / "objects" / "1.json").write_bytes(thing)
    scene(folder)


def label_folder(folder: Path, content: bytes) -> None:
    objects, _, rooms = content.partition(b"\n\n")
    (folder / "objects.csv").write_bytes(objects)
    (folder / "rooms.csv").write_bytes(rooms or "\n".join(ROOMS).encode())
    space = LabelSpace.load(folder)
    assert space.objects
    assert space.predicted_rooms
    assert all(label.label and label.plural for label in space.objects)


def misses(folder: Path, content: bytes) -> None:
    """No error at all: what is no miss is skipped."""
    (folder / "robot-1.jsonl").write_bytes(content)
    read = Misses.read(folder)
    assert all(miss.objects and miss.last_asked.year > 1969 for miss in read.open)
    read.take_in({"bed"})
    assert Misses.read(folder).open == ()


def taken(folder: Path, content: bytes) -> None:
    (folder / "robot-1.jsonl").write_bytes(as_json(MISS) + b"\n")
    (folder / "taken.json").write_bytes(content)
    Misses.read(folder).take_in()
    Misses.read(folder)


def model_folder(folder: Path, content: bytes) -> None:
    files = {
        "config.json": CONFIG,
        "tokenizer.json": {"a": 1},
        "model.safetensors.index.json": INDEX,
    }
    for name, value in files.items():
        (folder / name).write_bytes(as_json(value))
    for name in ("model-1.safetensors", "model-2.safetensors"):
        (folder / name).write_bytes(b"x")
    name = sorted(files)[len(content) % len(files)]
    (folder / name).write_bytes(content)
    found = resolve(str(folder))
    scorer_id(found, "float32", "cpu", scoring_kind(found, None))


def toml(random: Random) -> bytes:
    lines = list(TOML)
    at = random.randrange(len(lines))
    values = ["-1", "nan", "inf", "true", "[]", "{}", '"{"', "9" * 30, "9" * 5000,
              "[1, [2]]", "'''x'''", "1979-05-27", '"\\u0000"', "[" * 400]  # fmt: skip
    lines[at] = lines[at].partition("=")[0] + "= " + random.choice(values)
    text = "\n".join(lines).encode()
    return changed_bytes(text, random) if random.random() < 0.3 else text


TARGETS: dict[str, tuple[Callable[[Random], bytes], Callable[[Path, bytes], None]]] = {
    "room lines": (of_json_lines(ROOM), file_target("x.jsonl", lambda p: list(read_room_lines(p)),
                                                    scene, lambda p: read_counts(p, SPACE))),
    "nested rooms": (of_value(NESTED), scene_target("x.json")),
    "Spark-DSG JSON": (of_value(GRAPH), scene_target("x.json")),
    ".house": (of_lines(house_lines(), None), scene_target("x.house")),
    "HM3D": (of_lines(HM3D), scene_target("x.semantic.txt")),
    "HOV-SG": (of_value({"room_id": "0", "name": "x", "objects": ["1"]}), hovsg),
    "rooms in CSV": (of_lines(["room_id,object,room", "a,bed,bedroom", "a,sink,"]),
                     scene_target("x.csv")),
    "Hydra YAML": (yaml_bytes, file_target("x.yaml", read_hydra_labels)),
    "label space": (of_lines([*OBJECTS, "", *ROOMS]), label_folder),
    "CSV": (of_lines(COUNTS), file_target("x.csv", lambda p: list(read_csv(p, ("object",))),
                                          lambda p: read_counts(p, SPACE))),
    "scores": (of_lines(SCORES), file_target("x.csv", lambda p: read_scores(p, SPACE, "sum"))),
    "means": (of_lines(MEANS), file_target("x.csv", lambda p: read_scores(p, SPACE, "sum"),
                                           lambda p: read_scores(p, SPACE, "mean"))),
    "category mapping": (of_lines(MAPPING, "\t"), file_target("x.tsv", lambda p: object_namer(
        ReadOptions(object_labels="nyuclass", category_mapping=p)))),
    "build.toml": (toml, file_target("x.toml", BuildConfig.load)),
    "misses": (of_json_lines(MISS), misses),
    "taken in": (of_value(TAKEN), taken),
    "model folder": (of_value(INDEX | CONFIG), model_folder),
}  # fmt: skip


def survives(parse: Callable[[], object]) -> None:
    """Run a parser: it succeeds, or raises an error of ours of one line, in bounds."""
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    try:
        parse()
    except RoomtablesError as error:
        said = str(error)
    else:
        said = ""
    assert "\n" not in said
    assert len(said) < 2000
    said.encode()
    assert time.process_time() - started < MOST_SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - kilobytes < MOST_KILOBYTES


def run(folder: Path, examples: int, make: Make, parse: Callable[[Path, bytes], object]) -> None:
    """Draw inputs and read each, in a folder of its own."""
    numbers = iter(range(10**9))

    @settings(
        max_examples=examples,
        deadline=None,
        phases=[Phase.explicit, Phase.reuse, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 2**64))
    def once(seed: int) -> None:
        own = folder / str(next(numbers) % 50)
        for path in sorted(own.rglob("*"), reverse=True):
            path.unlink() if path.is_file() else path.rmdir()
        own.mkdir(exist_ok=True)
        content = make(Random(seed))
        survives(lambda: parse(own, content))

    once()


@pytest.mark.parametrize("target", TARGETS)
def test_parsers(tmp_path: Path, target: str) -> None:
    run(tmp_path, 100, *TARGETS[target])


@pytest.mark.faults
@pytest.mark.parametrize("target", TARGETS)
def test_parsers_for_long(tmp_path: Path, target: str) -> None:
    run(tmp_path, LONG, *TARGETS[target])


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    build(tables=folder, scorer=HashScorer(), labels=str(write_space(folder / "l", SPACE)), k=2)
    return folder


def published_target(
    tables: Path, name: str
) -> tuple[Callable[[Random], bytes], Callable[..., None]]:
    """A file of a published version, whose hash is made to fit."""
    version = SpaceFolder(tables, SPACE.name).current()
    content = (version.path / name).read_bytes()

    def parse(own: Path, changed: bytes) -> None:
        home = own / "home"
        home.mkdir(parents=True)
        target = home / version.name
        target.mkdir()
        document = json.loads((version.path / MANIFEST).read_bytes())
        for path in version.path.rglob("*"):
            inside = target / path.relative_to(version.path)
            inside.mkdir() if path.is_dir() else os.link(path, inside)
        (target / name).unlink()
        (target / name).write_bytes(changed)
        if name != MANIFEST:
            document["files"][name] = {
                "bytes": len(changed), "sha256": hashlib.sha256(changed).hexdigest(),
            }  # fmt: skip
            (target / MANIFEST).unlink()
            (target / MANIFEST).write_text(json.dumps(document))
        sha256 = hashlib.sha256((target / MANIFEST).read_bytes()).hexdigest()
        (home / CURRENT).write_text(f"{version.name} {sha256}\n")
        opened = SpaceFolder(own, "home").current()
        assert opened.manifest.coverage.combinations >= 0
        Lookup.open(opened.path / "lookup", opened.manifest)

    return of_value(json.loads(content)), parse


@pytest.mark.parametrize("name", [MANIFEST, "lookup/lookup.json"])
def test_published_files(tables: Path, tmp_path: Path, name: str) -> None:
    run(tmp_path, 60, *published_target(tables, name))


@pytest.mark.faults
@pytest.mark.parametrize("name", [MANIFEST, "lookup/lookup.json"])
def test_published_files_for_long(tables: Path, tmp_path: Path, name: str) -> None:
    run(tmp_path, LONG, *published_target(tables, name))


@pytest.mark.parametrize(
    "pointer", [b"", b"v", b"v\n", b"../x", b".", b"\x00", b"\xff", b"v " + b"0" * 64]
)
def test_pointers(tmp_path: Path, pointer: bytes) -> None:
    (tmp_path / "home" / "v").mkdir(parents=True)
    (tmp_path / "home" / "v" / MANIFEST).write_bytes(b"{}")
    (tmp_path / "home" / CURRENT).write_bytes(pointer)
    with pytest.raises(StoreError):
        SpaceFolder(tmp_path, "home").current()
    with pytest.raises(StoreError):
        Version.open(tmp_path / "home" / "v")


@pytest.mark.parametrize("parse", [read_csv, read_counts, read_scores])
def test_a_folder_or_nothing_instead_of_a_file(
    tmp_path: Path, parse: Callable[..., object]
) -> None:
    more = {read_csv: (("object",),), read_counts: (SPACE,), read_scores: (SPACE, "sum")}[parse]
    for path in (tmp_path, tmp_path / "absent.csv"):
        with pytest.raises(RoomtablesError, match="cannot read"):
            list(parse(path, *more))
