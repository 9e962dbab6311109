"""Hydra's label-space YAML files: names for a graph's label ids, or a label space of roomtables.

Reading YAML needs the extra ``scene-graphs``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from roomtables.errors import InputError
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel, normalise
from roomtables.limits import YAML_BYTES, MalformedError, read_bytes, yaml_value

_NOT_OBJECTS = frozenset({"", "unknown", "void", "unlabeled", "unlabelled", "misc"})


@dataclass(frozen=True, slots=True)
class HydraLabels:
    """A Hydra label space: each id's name, and which ids are objects, where the file lists them."""

    names: dict[int, str]
    objects: tuple[int, ...]


def read_hydra_labels(path: Path) -> HydraLabels:
    """A Hydra label space from its YAML file.

    Raises
    ------
    InputError
        The file cannot be read, is not YAML, or is not a label space.
    MissingExtraError
        PyYAML is not installed.
    """
    document = _load_yaml(path)
    entries = document.get("label_names") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(
            f"{path}: no `label_names`; give one of Hydra's config/label_spaces/*.yaml"
        )
    names: dict[int, str] = {}
    for index, entry in enumerate(entries):
        match entry:
            case {"label": int() as label, "name": str() | int() | float() | bool() | None as name}:
                names[label] = "" if name is None else str(name)
            case _:
                raise InputError(f"{path}, label_names[{index}]: expected label and name")
    return HydraLabels(names, _object_ids(document, names, path))


def _object_ids(document: dict[str, Any], names: dict[int, str], path: Path) -> tuple[int, ...]:
    listed = document.get("object_labels") or []
    if not isinstance(listed, list) or not all(isinstance(label, int) for label in listed):
        raise InputError(f"{path}: `object_labels` must be a list of label ids")
    unknown = [label for label in listed if label not in names]
    if unknown:
        raise InputError(f"{path}: `object_labels` lists {unknown[0]}, which has no name")
    return tuple(listed)


def _load_yaml(path: Path) -> Any:
    try:
        return yaml_value(read_bytes(path, YAML_BYTES))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except MalformedError as error:
        where = f"{path}, line {error.line}" if error.line else path
        raise InputError(f"{where}: not a YAML file of a label space ({error})") from error


def load_label_names(path: Path) -> dict[int, str]:
    """The names of a Hydra label space, by label id; raises as `read_hydra_labels` does."""
    return read_hydra_labels(path).names


def to_label_space(
    labels: HydraLabels,
    name: str,
    rooms: Sequence[RoomLabel],
    known: Sequence[ObjectLabel] = (),
) -> LabelSpace:
    """A label space of the objects that a Hydra label space names, with the rooms given.

    Names are normalised, labels that then read the same become one, and an object that ``known``
    lists, under its label or a synonym, takes over those names of it that are still free.

    Raises
    ------
    LabelSpaceError
        No name is left.
    """
    found = {normalise(labels.names[label]) for label in labels.objects or labels.names}
    kept = sorted(found - _NOT_OBJECTS)
    taken = set(kept)
    objects = []
    for label in kept:
        synonyms = sorted(_other_names(label, known) - taken)
        taken.update(synonyms)
        objects.append(replace(ObjectLabel.named(label), synonyms=tuple(synonyms)))
    return LabelSpace(name, tuple(objects), tuple(rooms))


def _other_names(label: str, known: Sequence[ObjectLabel]) -> set[str]:
    """What else the known object of this label or synonym is called."""
    groups = ({entry.label, *entry.synonyms} for entry in known)
    return next((group - {label} for group in groups if label in group), set())
