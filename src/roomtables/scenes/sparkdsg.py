"""Binary Spark-DSG files, through the package ``spark_dsg`` (the extra ``scene-graphs``).

A graph is taken as the JSON that ``spark_dsg`` itself writes for it, so there is one reader and one
writer of graphs.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from roomtables.errors import InputError, MissingExtraError


def graph_class() -> Any:
    """``spark_dsg.DynamicSceneGraph``.

    Raises
    ------
    MissingExtraError
        ``spark_dsg`` is not installed.
    """
    try:
        from spark_dsg import DynamicSceneGraph
    except ImportError as error:
        raise MissingExtraError("a .sparkdsg scene graph", "scene-graphs") from error
    return DynamicSceneGraph


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
            graph = loader.load(name)
        except Exception as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"{path}: not a readable .sparkdsg file ({reason}); save the graph again"
            ) from error
        graph.save(Path(folder) / "graph.json", include_mesh)
        document: dict[str, Any] = json.loads((Path(folder) / "graph.json").read_bytes())
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
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"spark_dsg cannot load the graph ({reason}); write .json") from error
