"""What an ONNX file says of itself: metadata that ``lm`` writes and :class:`OnnxScorer` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from roomtables.limits import MalformedError, json_value
from roomtables.scorer import SCORING_RULE_VERSION

MODEL_FILE, TOKENIZER_FILE = "model.onnx", "tokenizer.json"
METADATA_KEY = "roomtables"
"""The key of ``metadata_props`` that the facts stand under, as a JSON object."""

PACKED, PADDED = "trie", "padded"
"""The graphs that there are: rows of a token trie, or sequences padded on the right."""

INPUTS = {
    PACKED: ("token", "depth", "end", "positions", "asked", "target"),
    PADDED: ("token", "positions", "asked", "target"),
}
"""The inputs of each graph, all int64.

``token``, ``depth`` (position in the sentence) and ``end`` (the first column that does not see this
one) have shape (rows, columns); ``positions`` are flat indices of the nodes that are read;
``asked`` (an index into them) and ``target`` (a token id) have one entry for each log probability
of the output.
"""

_FORMAT = 1


class FactsError(ValueError):
    """The metadata are none of roomtables', or of another format: what is wrong with them."""


@dataclass(frozen=True)
class OnnxFacts:
    """The metadata of a model in ONNX.

    Attributes
    ----------
    model, revision, dtype : of the torch model that it was made from
    scorer_ids : the identity of that torch model on each device class
    graph : ``trie`` or ``padded``
    row_nodes : the most nodes in a row of a packed graph, unless one sentence needs more
    vocabulary : the tokens that the model knows
    context : the most tokens of a sentence that it reads; ``None``: no limit
    appended_eos : the token that the tokenizer puts last, which is not scored; ``None``: none
    parameters : the number of weights
    tokenizer_sha256 : of the file ``tokenizer.json`` that belongs to it
    probe, probe_nats : sentences, and the log probability that the torch model gives each
    probe_starts : the characters from which tokens of the probe count; empty: all count
    scoring_rule : the version of what is scored
    """

    model: str
    revision: str
    dtype: str
    scorer_ids: tuple[str, ...]
    graph: str
    row_nodes: int
    vocabulary: int
    context: int | None
    appended_eos: int | None
    parameters: int
    tokenizer_sha256: str
    probe: tuple[str, ...]
    probe_nats: tuple[float, ...]
    scoring_rule: str = SCORING_RULE_VERSION
    probe_starts: tuple[int, ...] = ()

    def to_json(self) -> str:
        """The value of :data:`METADATA_KEY`."""
        return json.dumps(asdict(self) | {"format": _FORMAT}, ensure_ascii=False, sort_keys=True)

    @classmethod
    def read(cls, metadata: Mapping[str, str]) -> OnnxFacts:
        """The facts in a file's ``metadata_props``.

        Raises
        ------
        FactsError
            They are missing, of another format, or of another version of what is scored.
        """
        try:
            value = json_value(metadata[METADATA_KEY])
            if value.pop("format") != _FORMAT:
                raise FactsError("another version of roomtables wrote it")
            facts = cls(**{name: _frozen(item) for name, item in value.items()})
        except KeyError as error:
            raise FactsError("roomtables did not write it") from error
        except (AttributeError, TypeError, MalformedError) as error:
            raise FactsError("its metadata are damaged") from error
        facts._check()
        return facts

    def _check(self) -> None:
        numbers = {"row_nodes", "vocabulary", "parameters"}
        optional = {"context", "appended_eos"}
        lists = {"scorer_ids": str, "probe": str, "probe_nats": float, "probe_starts": int}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in lists:
                kind = lists[field.name]
                right = type(value) is tuple and all(type(item) is kind for item in value)
            elif field.name in numbers | optional:
                right = type(value) is int or (field.name in optional and value is None)
            else:
                right = type(value) is str
            if not right:
                raise FactsError(f"its metadata are damaged (`{field.name}`)")
        if self.graph not in INPUTS or not self.scorer_ids:
            raise FactsError("its metadata are damaged (`graph`, `scorer_ids`)")
        probed = len(self.probe) == len(self.probe_nats)
        probed = probed and len(self.probe_starts) in {0, len(self.probe)}
        if min(self.row_nodes, self.vocabulary) < 1 or not probed:
            raise FactsError("its metadata are damaged (`row_nodes`, `vocabulary`, `probe`)")
        if self.scoring_rule != SCORING_RULE_VERSION:
            raise FactsError(
                f"it scores by rule {self.scoring_rule[:20]}, this roomtables by rule "
                f"{SCORING_RULE_VERSION}"
            )


def _frozen(item: Any) -> Any:
    return tuple(item) if isinstance(item, list) else item
