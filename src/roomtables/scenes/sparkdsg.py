"""Files in Spark-DSG's binary form, through the package ``spark_dsg``.

They are read and written by way of the JSON that ``spark_dsg`` itself writes for them, so that
`dsg` and `dsg_graph` serve both forms. Needs the extra ``scene-graphs``.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, first_line, needing
from roomtables.limits import SCENE_BYTES, json_value, read_bytes
from roomtables.scenes.dsg import graph_scene
from roomtables.scenes.dsg_binary import check_graph
from roomtables.scenes.dsg_graph import parse_graph
from roomtables.scenes.scene import ReadOptions, Scene
from roomtables.scenes.scene_file import SceneFile


def is_sparkdsg(file: SceneFile) -> bool:
    """Whether a file has the header of a binary Spark-DSG graph; its JSON has one as well."""
    return b"SPARK_DSG" in file.head[:32] and not file.is_json


def read_sparkdsg(file: SceneFile, options: ReadOptions) -> Scene:
    """One scene from a ``.sparkdsg`` file, read without its mesh.

    Raises
    ------
    InputError, MissingExtraError
        As `sparkdsg_document`, or as reading the same graph from JSON.
    """
    document = sparkdsg_document(file.path, include_mesh=False)
    return graph_scene(parse_graph(document, str(file.path)), file.path.stem, options)


def sparkdsg_document(path: Path, *, include_mesh: bool) -> dict[str, Any]:
    """The JSON of a ``.sparkdsg`` file.

    Raises
    ------
    InputError
        The file is damaged, or of a version that the installed ``spark_dsg`` cannot read.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    loader = graph_class()
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / "graph.sparkdsg"
        name.symlink_to(path.resolve())  # spark_dsg goes by the suffix
        try:
            check_graph(read_bytes(path, SCENE_BYTES), None)
            graph = loader.load(name)
            graph.save(Path(folder) / "graph.json", include_mesh)
            document: dict[str, Any] = json_value((Path(folder) / "graph.json").read_bytes())
        except Exception as error:
            raise InputError(
                f"{path}: not a readable .sparkdsg file ({first_line(error)}); save the graph again"
            ) from error
    return document


def write_sparkdsg(document: dict[str, Any], path: Path) -> None:
    """Write a graph's JSON as a ``.sparkdsg`` file.

    Raises
    ------
    InputError
        ``spark_dsg`` cannot load the graph.
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    loader = graph_class()
    with tempfile.TemporaryDirectory() as folder:
        name = Path(folder) / "graph.json"
        name.write_text(json.dumps(document), encoding="utf-8")
        try:
            loader.load(name).save(path, True)
        except Exception as error:
            raise InputError(
                f"spark_dsg cannot load the graph ({first_line(error)}); write .json"
            ) from error


def graph_class() -> Any:
    """``spark_dsg.DynamicSceneGraph``.

    Raises
    ------
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    with needing("a .sparkdsg scene graph"):
        from spark_dsg import DynamicSceneGraph

    return DynamicSceneGraph
