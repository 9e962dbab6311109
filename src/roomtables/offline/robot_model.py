"""The language model of a published version in ONNX, for a robot that takes the tables along."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from roomtables.errors import ModelError
from roomtables.labels import ObjectLabel
from roomtables.lm import export_onnx, identities
from roomtables.scorer import kept_as, scored_by
from roomtables.sentences import Template
from roomtables.storage.lookup import Lookup
from roomtables.storage.versions import Version

# Sentences that the ONNX file is checked on: single objects, and combinations of k.
_OBJECTS, _COMBINATIONS = 12, 8


def write_robot_model(version: Version, lookup: Lookup, folder: Path) -> None:
    """Write the model that scored a version's query sentences, and its tokenizer, into a folder.

    Raises
    ------
    ModelError
        No model scored query sentences, the model here is another, or it cannot become an ONNX file
        that gives the same scores.
    MissingExtraError
        torch, transformers or onnx is not installed.
    """
    settings, scored = version.manifest.settings, version.manifest.query_scorer_id
    if scored is None:
        raise ModelError(
            f"no model scored query sentences of {version.path}, so there is none to pack; "
            "leave --with-model out"
        )
    here = identities(
        settings.model, revision=settings.revision, dtype=settings.dtype, scoring=settings.scoring
    )
    if scored not in {kept_as(scorer_id, settings.scored) for scorer_id in here}:
        raise ModelError(
            f"the tables were scored by {scored_by(scored)}, the model here is {here[0]}; "
            "run `roomtables build`"
        )
    asked = list(_sample(version, lookup))
    sentences = [text for texts, _ in asked for text in texts]
    export_onnx(
        folder,
        sentences,
        settings.model,
        starts=[start for _, starts in asked for start in starts or ()] or None,
        revision=settings.revision,
        dtype=settings.dtype,
        scoring=settings.scoring,
    )


def _sample(version: Version, lookup: Lookup) -> Iterator[tuple[list[str], list[int] | None]]:
    """Sentences as the tables hold them, and their starts: some objects alone, and some
    combinations of k."""
    template = Template(version.manifest.settings.template[0])
    starts = template.starts(lookup.rooms, version.manifest.settings.scored)
    objects, size = lookup.objects, lookup.k
    for label in _spread(objects, _OBJECTS):
        yield template.compose([label], lookup.rooms), starts
    for label in _spread(objects, _COMBINATIONS):
        start = objects.index(label)
        yield template.compose(objects[start : start + size], lookup.rooms), starts


def _spread(objects: Sequence[ObjectLabel], most: int) -> Sequence[ObjectLabel]:
    """At most so many objects, from all over the alphabet."""
    return objects[:: -(-len(objects) // most)]
