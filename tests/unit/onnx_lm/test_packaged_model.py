"""household-lm in ONNX: in step with its safetensors, small, exact, refused when damaged."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from pipeline.household_lm.onnx import sample_sentences

from roomtables.config import load_labels
from roomtables.errors import ModelError
from roomtables.lm import identities, load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.onnx_lm import MODEL_FILE, TOKENIZER_FILE, OnnxScorer
from roomtables.onnx_lm.facts import METADATA_KEY
from roomtables.scorer import Scorer
from roomtables.sentences import Template

FILE = EMBEDDED_FOLDER / MODEL_FILE
SPACE = load_labels("mpcat40")


@pytest.fixture(scope="module")
def scorer() -> OnnxScorer:
    return OnnxScorer.open(EMBEDDED_FOLDER)


@pytest.fixture(scope="module")
def torch_scorer() -> Scorer:
    return load_scorer()


def test_it_is_made_from_the_weights_beside_it(scorer: OnnxScorer) -> None:
    assert scorer.facts.scorer_ids == identities("household-lm")
    assert isinstance(scorer, Scorer)
    assert (scorer.scorer_id, scorer.strategy) == (scorer.facts.scorer_ids[0], "trie")
    assert all(scorer.is_model_of(scorer_id) for scorer_id in identities("household-lm"))
    assert not scorer.is_model_of(identities("household-lm", dtype="float16")[0])
    weights = (EMBEDDED_FOLDER / "model.safetensors").stat().st_size
    assert FILE.stat().st_size < 1.05 * weights  # in half precision, as they were trained


def test_it_scores_as_torch_does(scorer: OnnxScorer, torch_scorer: Scorer) -> None:
    sentences = [
        *sample_sentences(),
        *Template().compose(SPACE.objects[3:6], SPACE.rooms),
        "a",
        " twice  spaced, naïve & 中 <s> emoji 🛋️ ",
        "A room containing sofas, " * 30,  # longer than half a row
    ]
    scores, expected = scorer.score(sentences), torch_scorer.score(sentences)
    assert [score.token_count for score in scores] == [score.token_count for score in expected]
    found = np.array([score.log_prob for score in scores])
    np.testing.assert_allclose(found, [score.log_prob for score in expected], atol=1e-3, rtol=0)
    assert list(scorer.score_stream(iter(sentences))) == scores


def test_what_cannot_be_scored_is_refused(scorer: OnnxScorer) -> None:
    assert scorer.score([]) == []
    for sentence, why in {"": "empty", "  ": "empty", "towel " * 600: "tokens, more than"}.items():
        with pytest.raises(ModelError, match=why):
            scorer.score(["A room.", sentence])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the file and its tokenizer, to damage."""
    for name in (MODEL_FILE, TOKENIZER_FILE):
        shutil.copy(EMBEDDED_FOLDER / name, tmp_path)
    return tmp_path


def test_a_file_opens_by_its_path_or_its_folder(folder: Path) -> None:
    assert OnnxScorer.open(folder / MODEL_FILE).facts == OnnxScorer.open(str(folder)).facts


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def emptied(content: bytes) -> bytes:
    return b""


def turned_into_text(content: bytes) -> bytes:
    return b"not a model\n" * 100


def with_zeros_inside(content: bytes) -> bytes:
    """Weights that are other than they were."""
    model = onnx.load_from_string(content)
    weights = max(model.graph.initializer, key=lambda tensor: len(tensor.raw_data))
    weights.raw_data = bytes(len(weights.raw_data))
    return model.SerializeToString()


def stripped_of_metadata(content: bytes) -> bytes:
    model = onnx.load_from_string(content)
    del model.metadata_props[:]
    return model.SerializeToString()


def of_somebody_else(content: bytes) -> bytes:
    value = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    same = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Identity", ["x"], ["y"])], "g", [value], [same]
    )
    opset = [onnx.helper.make_opsetid("", 18)]
    return onnx.helper.make_model(graph, opset_imports=opset, ir_version=9).SerializeToString()


def claiming(**facts: object) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        model = onnx.load_from_string(content)
        (prop,) = [prop for prop in model.metadata_props if prop.key == METADATA_KEY]
        prop.value = json.dumps(json.loads(prop.value) | facts)
        return model.SerializeToString()

    return change


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (cut, "cannot read"),
        (emptied, "cannot read"),
        (turned_into_text, "cannot read"),
        (with_zeros_inside, "nats"),
        (stripped_of_metadata, "did not write it"),
        (of_somebody_else, "did not write it"),
        (claiming(format=2), "another version"),
        (claiming(scoring_rule="2"), "rule 2"),
        (claiming(vocabulary="many"), "damaged .`vocabulary`"),
        (claiming(extra=1), "damaged"),
        (claiming(vocabulary=0), "damaged"),
        (claiming(row_nodes=-1), "damaged"),
        (claiming(probe_nats=[]), "damaged"),
        (claiming(graph="padded"), "other inputs"),
        (claiming(graph="square"), "damaged"),
        (claiming(probe_nats=[0.0, 0.0]), "nats"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(
    folder: Path, damage: Callable[[bytes], bytes], why: str
) -> None:
    file = folder / MODEL_FILE
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ModelError, match=why) as refused:
        OnnxScorer.open(folder)
    assert "\n" not in str(refused.value)
    assert MODEL_FILE in str(refused.value)


def test_a_missing_file_or_another_tokenizer_is_refused(folder: Path) -> None:
    tokenizer = folder / TOKENIZER_FILE
    tokenizer.write_bytes(tokenizer.read_bytes() + b" ")
    with pytest.raises(ModelError, match="not the one that it was made with"):
        OnnxScorer.open(folder)
    tokenizer.unlink()
    with pytest.raises(ModelError, match="cannot read"):
        OnnxScorer.open(folder)
    (folder / MODEL_FILE).unlink()
    with pytest.raises(ModelError, match="cannot read"):
        OnnxScorer.open(folder)


def test_it_needs_neither_torch_nor_transformers() -> None:
    code = (
        "import sys\n"
        "from roomtables.onnx_lm import OnnxScorer\n"
        "print(OnnxScorer.open(sys.argv[1]).score(['A lamp is lit.'])[0].token_count)\n"
        "print(*{'torch', 'transformers', 'onnx', 'safetensors'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", code, str(EMBEDDED_FOLDER)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "5\n\n"
