"""A binary graph that declares more than it holds is refused before it is decoded."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import pytest

from mutations import changed_bytes
from roomtables.errors import InputError
from roomtables.limits import MalformedError
from roomtables.scenes.dsg_binary import check_graph
from roomtables.scenes.live import GraphCodec
from roomtables.scenes.reader import read_scene

spark_dsg = pytest.importorskip("spark_dsg")

NEWEST = (1, 1, 3)
VERSIONS = [(1, 0, 2), (1, 0, 3), (1, 0, 4), (1, 0, 5), (1, 0, 6), (1, 1, 0), (1, 1, 1), (1, 1, 2),
            NEWEST]  # fmt: skip
LONG = int(os.environ.get("ROOMTABLES_FUZZ", "3000"))
VERTEX = {"block": [1, 2, 3], "voxel_pos": [1.0, 2.0, 3.0], "vertex": 7, "label": 3}
MESH = {
    "points": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
    "colors": [{"r": 1, "g": 2, "b": 3, "a": 4}] * 2,
    "stamps": [1, 2], "labels": [1, 2], "first_seen_stamps": [1, 2], "faces": [[0, 1, 1]],
    "has_labels": True, "has_timestamps": True, "has_first_seen_stamps": True, "has_colors": True,
}  # fmt: skip
# Something in every list that a node may have.
FILLED = {
    "mesh_connections": [1, 2], "pcl_mesh_connections": [1, 2], "mesh_vertex_labels": [1, 2, 3],
    "deformation_connections": [4], "pcl_boundary_connections": [5, 6],
    "boundary": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
    "voxblox_mesh_connections": [VERTEX, VERTEX | {"label": None}],
    "semantic_class_probabilities": {"kitchen": 0.5, "bath": 0.25},
    "trajectory_positions": [[1.0, 2.0, 3.0]], "trajectory_timestamps": [1],
    "dynamic_object_points": [[[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]], []],
    "details": {"a": [1, 2], "b": []}, "states_0": [1, 2], "states_1": [0],
    "semantic_feature": {"cols": 2, "rows": 3, "data": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]},
    "name": "Küche", "metadata": {"k": [1]}, "dbow_ids": [1, 2, 3], "dbow_values": [0.5, 0.25],
}  # fmt: skip
TYPES = [name for name in dir(spark_dsg) if name.endswith("NodeAttributes")]
TYPES += ["KhronosObjectAttributes"]


@pytest.fixture(scope="module")
def message(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A graph with a node of every type, each list filled, and a mesh."""
    made = spark_dsg.DynamicSceneGraph()
    for index, name in enumerate(TYPES):
        made.add_node("PLACES", (ord("p") << 56) + index, getattr(spark_dsg, name)())
    made.insert_edge(ord("p") << 56, (ord("p") << 56) + 1)
    path = tmp_path_factory.mktemp("graph") / "graph.json"
    made.save(path, True)
    document = json.loads(path.read_text())
    for node in document["nodes"]:
        own = node["attributes"]
        for key in own.keys() & FILLED.keys():
            own[key] = FILLED[key]
        if own["type"] == "KhronosObjectAttributes":
            own |= {"first_observed_ns": [1, 2], "last_observed_ns": [3]}
            own["mesh"] |= MESH
    document["mesh"] = MESH | {"header": document["SPARK_DSG_header"]}
    path.write_text(json.dumps(document))
    found: bytes = spark_dsg.DynamicSceneGraph.load(path).to_binary(True)
    return found


def numbers(text: str, *values: Any) -> bytes:
    """Numbers as a graph holds them: each type's byte, then the number."""
    kinds = {"B": 0xCC, "I": 0xCE, "Q": 0xCF, "q": 0xD3, "d": 0xCB}
    return b"".join(
        struct.pack(f"<B{kind}", kinds[kind], value)
        for kind, value in zip(text, values, strict=True)
    )


def a_list(length: int, content: bytes = b"") -> bytes:
    return struct.pack("<BI", 0xDD, length) + content


def a_text(text: bytes) -> bytes:
    return a_list(len(text), text)


def file_of(version: tuple[int, int, int]) -> bytes:
    """A file of two nodes and an edge as a version of spark_dsg wrote it."""
    header = a_text(b"SPARK_DSG") + a_text(b"main") + numbers("BBB", *version)
    layer = a_list(2, numbers("qI", 3, 0)) if version >= (1, 1, 2) else numbers("q", 3)
    types = a_list(1, a_text(b"NodeAttributes")) + a_list(1, a_text(b"EdgeAttributes"))
    names = b""
    if version >= (1, 1, 0):
        key = a_list(2, numbers("qI", 3, 0)) if version >= (1, 1, 1) else numbers("q", 3)
        names = a_list(1, a_text(b"PLACES") + key)
    metadata = a_text(b"{}") if version >= (1, 0, 6) else b""
    nodes = b""
    for index in (1, 2):
        stamp = (
            numbers("I", 0)
            if version >= (1, 1, 0)
            else (b"\xc0" if index == 1 else numbers("q", 9))
        )
        flags = b"\xc2\xc2" if version >= (1, 0, 4) else b"\xc2"
        nodes += a_list(4, numbers("qQ", 3, (ord("p") << 56) + index)) + stamp + numbers("B", 0)
        nodes += metadata + numbers("dddQ", 1.0, 2.0, 3.0, 5) + flags
    lists = b"\0" + nodes + b"\1" + (b"" if version >= (1, 1, 0) else b"\0\1")
    ends = numbers("QQB", (ord("p") << 56) + 1, (ord("p") << 56) + 2, 0)
    edge = a_list(3, ends) + metadata + b"\xc2" + numbers("d", 2.0)
    return header + a_list(1, layer) + types + names + metadata + lists + b"\0" + edge + b"\1\xc2"


def cuts_that_pass(content: bytes, version: tuple[int, int, int] | None) -> list[int]:
    """Where a graph may be cut off."""
    ends = []
    for end in range(len(content)):
        with suppress(MalformedError):
            check_graph(content[:end], version)
            ends.append(end)
    return ends


def test_a_graph_of_every_type_passes_whole_and_in_no_part(message: bytes) -> None:
    check_graph(message, NEWEST)
    assert len(cuts_that_pass(message, NEWEST)) == 1  # before the mesh, which may be absent


@pytest.mark.parametrize("version", VERSIONS)
def test_files_of_every_version_pass(tmp_path: Path, version: tuple[int, int, int]) -> None:
    content = file_of(version)
    check_graph(content, None)
    path = tmp_path / "graph.sparkdsg"
    path.write_bytes(content)
    assert spark_dsg.DynamicSceneGraph.load(path).num_nodes() == 2
    header = len(a_text(b"SPARK_DSG") + a_text(b"main") + numbers("BBB", *version))
    passing = [end for end in cuts_that_pass(content, None) if end >= header]
    assert passing == [len(content) - 1]  # before the mesh


def test_what_is_wrong_is_told(message: bytes, tmp_path: Path) -> None:
    forged = tmp_path / "forged.sparkdsg"
    head = a_text(b"SPARK_DSG") + a_text(b"main") + numbers("BBB", *NEWEST)
    forged.write_bytes(head + message.replace(b"\xdd\2\0\0\0\xcf\1", b"\xdd\0\0\0\x40\xcf\1"))
    with pytest.raises(InputError, match="it declares 1073741824 values"):
        read_scene(forged)
    with pytest.raises(InputError, match="it declares 4294967295 values"):
        GraphCodec().decode(b"\xdd\xff\xff\xff\xff" + message[5:])
    deep = a_text(b"[" * 5000 + b"]" * 5000)
    with pytest.raises(MalformedError, match="its metadata: nested more than 100 deep"):
        check_graph(message.replace(a_text(b'{"k":[1]}'), deep), NEWEST)
    strange = message.replace(b"AgentNode", b"OtherNode")
    with pytest.raises(MalformedError, match="of an unknown type"):
        check_graph(strange, NEWEST)
    with pytest.raises(
        MalformedError, match=r"spark_dsg 1\.9\.0 wrote it, and its layout may be a new"
    ):
        check_graph(strange, (1, 9, 0))


CHILD = """
import resource, sys
from pathlib import Path
import spark_dsg
from roomtables.errors import InputError
from roomtables.scenes.live import GraphCodec
codec = GraphCodec()
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
refused = 0
with Path(sys.argv[1]).open("rb") as messages:
    while size := messages.read(4):
        try:
            codec.decode(messages.read(int.from_bytes(size, "little")))
        except InputError as error:
            refused += 1
            assert "\\n" not in str(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, refused)
"""


def kilobytes(folder: Path, messages: list[bytes]) -> int:
    """By how much a process that decodes messages grows."""
    path = folder / "messages"
    path.write_bytes(b"".join(len(m).to_bytes(4, "little") + m for m in messages))
    command = [sys.executable, "-c", CHILD, str(path)]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    grown, refused = map(int, found.splitlines()[-1].split())
    assert refused > len(messages) // 4
    return grown


def forged(message: bytes, step: int) -> list[bytes]:
    """A length written over every place of a message, whether there is one or not."""
    lengths = [2**32 - 1, 2**31 - 1, 10**8, 10**6]
    return [
        message[:at] + struct.pack("<I", lengths[at // step % 4]) + message[at + 4 :]
        for at in range(0, len(message), step)
    ]


def test_no_forged_length_takes_the_memory(message: bytes, tmp_path: Path) -> None:
    random = Random(7)
    changed = [changed_bytes(message, random) for _ in range(200)]
    lists = [at for at in range(len(message)) if message[at] == 0xDD]
    blown = [message[: at + 1] + b"\xff\xff\xff\x7f" + message[at + 5 :] for at in lists]
    assert kilobytes(tmp_path, forged(message, 7) + changed + blown) < 50_000


@pytest.mark.faults
def test_no_forged_length_takes_the_memory_for_long(message: bytes, tmp_path: Path) -> None:
    random = Random(11)
    changed = [changed_bytes(message, random) for _ in range(10 * LONG)]
    assert kilobytes(tmp_path, forged(message, 1) + changed) < 50_000
