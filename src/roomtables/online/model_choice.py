"""Which language model answers for a published version: one that scored it, in ONNX or in torch.

An ONNX file beside the tables comes first, then the one in the package, then the model that the
tables were built with, where torch is installed. Each answers only if it is the model that scored
the tables' query sentences, on whatever device. Where none did, because the single-object scores
were imported and no combination was asked for, it is the model that the build was set to.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from roomtables.errors import MissingExtraError, RoomtablesError, first_line
from roomtables.lm import EMBEDDED_MODEL, identities, load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.onnx_lm import MODEL_FILE, TOKENIZER_FILE, OnnxScorer
from roomtables.scorer import Scorer, kept_as, scored_by
from roomtables.storage.files import refuse_outside
from roomtables.storage.manifest import FileFacts, Manifest
from roomtables.storage.refusals import refusal
from roomtables.storage.versions import MODEL

log = logging.getLogger(__name__)


class ModelChoice:
    """Looks for the model of a version, and remembers why a file or a package was of no use.

    Parameters
    ----------
    manifest : of the version
    version : the folder of the version; ``None``: no file beside the tables is looked for
    """

    def __init__(self, manifest: Manifest, version: Path | None) -> None:
        self._manifest = manifest
        self._version = version
        self._damaged: list[str] = []
        self._missing: list[str] = []

    def load(self) -> Scorer | None:
        """The model; ``None``, and one warning of what to do, where there is none."""
        scorer = self._from_onnx() or self._from_torch()
        why = "; ".join(dict.fromkeys(self._damaged + self._missing))
        if scorer is None:
            log.warning(
                "no language model here, so the tables alone decide what no table holds: %s, "
                "or pass --offline", why,
            )  # fmt: skip
        elif self._damaged:
            log.warning("%s; until then the model runs on torch", "; ".join(self._damaged))
        return scorer

    def _from_onnx(self) -> Scorer | None:
        for path in self._onnx_files():
            try:
                self._check_as_noted(path)
                scorer = OnnxScorer.open(path)
            except MissingExtraError as error:
                self._missing.append(str(error))
                return None
            except (RoomtablesError, OSError) as error:
                self._damaged.append(str(error))
                continue
            except MemoryError as error:
                self._missing.append(_out_of_memory(error))
                continue
            if self._scored_by(scorer.facts.scorer_ids):
                return scorer
            self._missing.append(self._other(scorer.scorer_id))
        return None

    def _onnx_files(self) -> Iterator[Path]:
        if self._version is not None:
            beside = self._version / MODEL / MODEL_FILE
            if beside.exists() or f"{MODEL}/{MODEL_FILE}" in self._manifest.files:
                yield beside
        scored, settings = self._manifest.query_scorer_id, self._manifest.settings
        set_to = settings.model if settings.dtype == "float32" else None
        name = set_to if scored is None else scored.partition("@")[0]
        if name == EMBEDDED_MODEL:
            yield EMBEDDED_FOLDER / MODEL_FILE

    def _check_as_noted(self, path: Path) -> None:
        """Refuse files beside the tables that are not those that the manifest notes.

        Raises
        ------
        RoomtablesError, OSError
            A file leads out of the tables, is not as noted, or cannot be read.
        """
        version = self._version
        if version is None or path.parent.parent != version:
            return
        refuse_outside(version.parent.parent, path.parent, path, path.with_name(TOKENIZER_FILE))
        for file in (path, path.with_name(TOKENIZER_FILE)):
            noted = self._manifest.files.get(f"{MODEL}/{file.name}")
            if noted is not None and noted != FileFacts.of(file):
                raise RoomtablesError(f"{file} is damaged; unpack the archive of the tables again")

    def _from_torch(self) -> Scorer | None:
        settings = self._manifest.settings
        if any(find_spec(package) is None for package in ("torch", "transformers")):
            if not (self._damaged or self._missing):
                self._missing.append(
                    "run `pip install 'roomtables[lm]'`, take the model along with "
                    "`roomtables export --with-model`"
                )
            return None
        try:
            found = identities(
                settings.model,
                revision=settings.revision,
                dtype=settings.dtype,
                scoring=settings.scoring,
            )
            if not self._scored_by(found):
                self._missing.append(self._other(found[0]))
                return None
            return load_scorer(
                settings.model,
                revision=settings.revision,
                dtype=settings.dtype,
                device="auto",
                scoring=settings.scoring,
            )
        except (RoomtablesError, ImportError, OSError) as error:
            self._missing.append(str(error))
            return None
        except MemoryError as error:
            self._missing.append(_out_of_memory(error))
            return None

    def _scored_by(self, scorer_ids: tuple[str, ...]) -> bool:
        scored = self._manifest.query_scorer_id
        rule = self._manifest.settings.scored
        return scored is None or scored in {kept_as(found, rule) for found in scorer_ids}

    def _other(self, scorer_id: str) -> str:
        scored = scored_by(str(self._manifest.query_scorer_id))
        return (
            f"the tables were scored by {scored}, the model here is {scorer_id}; "
            "run `roomtables build`"
        )


def _out_of_memory(error: MemoryError) -> str:
    return str(refusal(error) or first_line(error))
