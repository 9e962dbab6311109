"""A causal language model in ONNX, behind the :class:`roomtables.scorer.Scorer` protocol."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from roomtables.errors import MissingExtraError, ModelError, first_line
from roomtables.onnx_lm.facts import (
    INPUTS,
    MODEL_FILE,
    PACKED,
    TOKENIZER_FILE,
    FactsError,
    OnnxFacts,
)
from roomtables.packing.sequences import FloatArray, Sequences, padded_batches, sort_sequences
from roomtables.packing.tokens import Encoded, WordTokenizer
from roomtables.packing.trie import Layout, build_trie, sum_paths
from roomtables.packing.windows import unzipped, windows
from roomtables.scorer import ONE_THREAD_PARAMETERS, TOLERANCE_NATS, SentenceScore
from roomtables.token_limits import TokenLimits, quoted

_WINDOW = 8192  # sentences that are packed together
# Tokens of a pass: enough to keep the matrix products busy, and no more than some 8 MB of logits.
_MOST_TOKENS = 512
_MOST_LOGITS = 1 << 21
_BYTES_OF_A_WEIGHT = 2  # in half precision
_AGAIN = "run `roomtables export --with-model` again, or install roomtables again"


class OnnxScorer:
    """Scores sentences exactly as the torch model does that the file was made from.

    All sentences of a call run in batched passes in which a shared prefix runs once. Threads may
    share one.

    Attributes
    ----------
    path : the file
    facts : what the file says of itself
    """

    def __init__(
        self, path: Path, session: Any, tokenizer: Any, facts: OnnxFacts, runtime: str
    ) -> None:
        self.path = path
        self.facts = facts
        self._session = session
        # Not its batches, which keep threads of their own.
        self._tokens = WordTokenizer(
            tokenizer, lambda sentences: [tokenizer.encode(sentence).ids for sentence in sentences]
        )
        self._runtime = runtime
        self._limits = TokenLimits(
            self.scorer_id, facts.vocabulary, facts.context, facts.appended_eos
        )
        fitting = min(_MOST_TOKENS, _MOST_LOGITS // facts.vocabulary)
        self._budget = max(facts.row_nodes, fitting)

    @classmethod
    def open(cls, path: str | Path, *, probe: bool = True) -> OnnxScorer:
        """Open an ONNX file (or the folder that holds ``model.onnx``) and its ``tokenizer.json``.

        ``probe``: two sentences are scored, and compared with what the torch model gave them.

        Raises
        ------
        ModelError
            A file is missing or damaged, roomtables did not write it, or its scores are not those
            of the model that it was made from.
        MissingExtraError
            ONNX Runtime or ``tokenizers`` is not installed.
        """
        path = Path(path)
        path = path / MODEL_FILE if path.is_dir() else path
        # ONNX Runtime's own packages tell their maker of every session, from version 1.29 on, and
        # leave a file in the temporary folder, unless told not to before they are imported.
        os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
        try:
            import onnxruntime
            from tokenizers import Tokenizer
        except ImportError as error:
            raise MissingExtraError(f"the language model {path}", "robot") from error
        try:
            session = onnxruntime.InferenceSession(
                path, _options(onnxruntime, path), providers=["CPUExecutionProvider"]
            )
            facts = _facts(session)
            tokenizer = _tokenizer(Tokenizer, path.with_name(TOKENIZER_FILE), facts)
        except FactsError as error:
            raise ModelError(f"{path}: {error}; {_AGAIN}") from error
        except Exception as error:  # whatever a damaged file is to either package
            raise ModelError(f"cannot read {path} ({first_line(error)}); {_AGAIN}") from error
        scorer = cls(path, session, tokenizer, facts, onnxruntime.__version__)
        if probe:
            scorer._check_probe()
        return scorer

    @property
    def scorer_id(self) -> str:
        """The identity, on a CPU, of the torch model that the file was made from."""
        return self.facts.scorer_ids[0]

    def is_model_of(self, scorer_id: str) -> bool:
        """Whether the file was made from the model of this identity, on whatever device."""
        return scorer_id in self.facts.scorer_ids

    @property
    def strategy(self) -> str:
        """``trie`` where a shared prefix runs once, else ``padded``."""
        return self.facts.graph

    def describe(self) -> Mapping[str, str]:
        """Provenance: model, revision, dtype, device, scoring, strategy, runtime's version."""
        return {
            "model": self.facts.model,
            "revision": self.facts.revision,
            "dtype": self.facts.dtype,
            "device": "cpu",
            "scoring": "causal",
            "strategy": self.strategy,
            "parameters": str(self.facts.parameters),
            "onnxruntime": self._runtime,
        }

    def score(
        self, sentences: Sequence[str], starts: Sequence[int] | None = None
    ) -> list[SentenceScore]:
        """Scores (nats) in the order given.

        ``starts`` are the characters from which tokens count; see
        :meth:`roomtables.scorer.Scorer.score`.

        Raises
        ------
        ModelError
            A sentence is empty or longer than the model's context, no token of it counts, or a
            score is not finite.
        """
        return list(self.score_stream(sentences, starts))

    def score_stream(
        self, sentences: Iterable[str], starts: Iterable[int] | None = None
    ) -> Iterator[SentenceScore]:
        """One score per sentence, in order, in bounded memory; raises as :meth:`score`."""
        for window in windows(sentences, starts, _WINDOW):
            yield from self._score_window(*unzipped(window))

    def _score_window(
        self, window: Sequence[str], starts: Sequence[int] | None
    ) -> list[SentenceScore]:
        encoded = self._encode(window, starts)
        sequences, index = sort_sequences(*encoded)
        log_probs = self._log_probs(sequences)[index]
        bad = np.flatnonzero(~np.isfinite(log_probs))
        if len(bad):
            raise ModelError(
                f"{self.scorer_id} gives {quoted(window[bad[0]])} a log probability of "
                f"{log_probs[bad[0]]}; {_AGAIN}"
            )
        return list(map(SentenceScore, log_probs.tolist(), encoded.counts.tolist()))

    def _encode(self, window: Sequence[str], starts: Sequence[int] | None) -> Encoded:
        self._limits.refuse_empty(window)
        tokens = self._tokens(window)
        if self.facts.appended_eos is not None:
            tokens = tokens.without_last(self.facts.appended_eos)
        self._limits.check_all(window, tokens.flat, tokens.lengths)
        found = None if starts is None else self._tokens.first_counted(window, starts)
        return Encoded(tokens, self._limits.first_scored(window, found, tokens.lengths))

    def _log_probs(self, sequences: Sequences) -> FloatArray:
        """Log probability in nats of each sequence, ``[sequences]``."""
        if self.facts.graph != PACKED:
            return self._padded(sequences)
        scores = np.empty(len(sequences))
        short = sequences.lengths <= self.facts.row_nodes // 2
        if short.any():
            scores[short] = self._packed(sequences.take(short), self.facts.row_nodes)
        for at in np.flatnonzero(~short):  # each in a row of its own
            alone = np.arange(len(sequences)) == at
            scores[at] = self._packed(sequences.take(alone), int(sequences.lengths[at]))[0]
        return scores

    def _packed(self, sequences: Sequences, row_nodes: int) -> FloatArray:
        tree = build_trie(sequences)

        def read(layout: Layout) -> FloatArray:
            return self._run(
                token=layout.token,
                depth=layout.depth,
                end=layout.end,
                positions=layout.positions,
                asked=layout.asked,
                target=tree.edge_token[layout.edges],
            )

        return sum_paths(tree, row_nodes, max(row_nodes, self._budget), read)

    def _padded(self, sequences: Sequences) -> FloatArray:
        scores = np.empty(len(sequences))
        for batch in padded_batches(sequences, self._budget):
            log_probs = self._run(
                token=batch.token,
                positions=batch.positions,
                asked=np.arange(len(batch.positions)),
                target=batch.target,
            )
            scores[batch.rows] = np.bincount(batch.line, log_probs, minlength=len(batch.rows))
        return scores

    def _run(self, **inputs: Any) -> FloatArray:
        """One pass of the graph: its log probabilities in nats, ``[asked]``."""
        try:
            (log_probs,) = self._session.run(None, inputs)
        except Exception as error:  # the runtime has exceptions of its own, memory among them
            raise ModelError(f"{self.scorer_id} failed ({first_line(error)}); {_AGAIN}") from error
        return np.asarray(log_probs, np.float64)

    def _check_probe(self) -> None:
        starts = self.facts.probe_starts or None
        scores = [score.log_prob for score in self.score(self.facts.probe, starts)]
        apart = np.abs(np.subtract(scores, self.facts.probe_nats)).max(initial=0.0)
        if apart > TOLERANCE_NATS:
            raise ModelError(
                f"{self.path} is {apart:.2g} nats from the scores of {self.scorer_id}, which it "
                f"was made from; {_AGAIN}"
            )


def _options(onnxruntime: Any, path: Path) -> Any:
    """Settings that keep memory low, and processors free for other programs."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # errors are raised, too
    options.inter_op_num_threads = 1
    if path.stat().st_size < ONE_THREAD_PARAMETERS * _BYTES_OF_A_WEIGHT:
        options.intra_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.enable_cpu_mem_arena = False
    options.enable_mem_pattern = False
    return options


def _facts(session: Any) -> OnnxFacts:
    facts = OnnxFacts.read(session.get_modelmeta().custom_metadata_map)
    given = sorted(declared.name for declared in session.get_inputs())
    if given != sorted(INPUTS[facts.graph]):
        raise FactsError("its graph has other inputs than its metadata say")
    return facts


def _tokenizer(tokenizers: Any, path: Path, facts: OnnxFacts) -> Any:
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != facts.tokenizer_sha256:
        raise FactsError(f"{path.name} is not the one that it was made with")
    tokenizer = tokenizers.from_str(content.decode())
    tokenizer.no_truncation()
    tokenizer.no_padding()
    return tokenizer
