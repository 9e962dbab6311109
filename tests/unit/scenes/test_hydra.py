"""Hydra's label-space YAML files."""

from __future__ import annotations

from pathlib import Path

import pytest

from roomtables.errors import InputError
from roomtables.labels import LabelSpace, RoomLabel
from roomtables.scenes.hydra import read_hydra_labels, to_label_space

YAML = """\
total_semantic_labels: 5
dynamic_labels: [4]
object_labels: [1, 2, 3]
label_names:
  - {label: 0, name: unknown}
  - {label: 1, name: Wall_Decoration}
  - {label: 2, name: plant, name_descriptive: a plant}
  - {label: 3, name: Plant}
  - {label: 4, name: human}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "space.yaml"
    path.write_text(text)
    return path


def test_objects_become_a_label_space_that_loads_again(tmp_path: Path) -> None:
    labels = read_hydra_labels(write(tmp_path, YAML))
    space = to_label_space(labels, "mine", [RoomLabel.named("kitchen")])
    assert [label.label for label in space.objects] == ["plant", "wall decoration"]
    folder = tmp_path / "mine"
    folder.mkdir()
    for name, text in space.csv_files().items():
        (folder / name).write_text(text)
    assert LabelSpace.load(folder) == space


def test_without_object_labels_every_named_label_counts(tmp_path: Path) -> None:
    text = YAML.replace("object_labels: [1, 2, 3]\n", "")
    space = to_label_space(
        read_hydra_labels(write(tmp_path, text)), "mine", [RoomLabel.named("kitchen")]
    )
    assert [label.label for label in space.objects] == ["human", "plant", "wall decoration"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "not a YAML file"),
        ("a: 1", "no `label_names`"),
        ("- 1", "no `label_names`"),
        ("label_names: [{label: x, name: bed}]", r"label_names\[0\]: expected label and name"),
        ("label_names: [{label: 1, name: bed}]\nobject_labels: [2]", "lists 2, which has no name"),
        ("label_names: !!python/object:os.system {}", "not a YAML file"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_hydra_labels(write(tmp_path, text))


def test_hydras_own_files_are_read(shared_data: Path) -> None:
    for path in sorted((shared_data / "scene_graphs" / "label_spaces").glob("*.yaml")):
        labels = read_hydra_labels(path)
        space = to_label_space(labels, path.stem, [RoomLabel.named("kitchen")])
        assert len(space.objects) <= len(labels.names)
