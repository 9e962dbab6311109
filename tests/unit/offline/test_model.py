"""Which scorer a build loads: the embedded model's ONNX file where it is that model, else torch."""

import re
import subprocess
import sys

import duckdb
import pytest

from roomtables.config import BuildConfig
from roomtables.lm import identify, load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.offline.model import LazyScorer
from roomtables.onnx_lm import OnnxScorer
from roomtables.storage.score_cache import SentenceCache

BUILD = """
import sys
for name in ("torch", "transformers"): sys.modules[name] = None
from roomtables import build
report = build(tables=sys.argv[1], labels=sys.argv[2], device="cpu", progress=True)
print(report.sentences_scored)
"""


def test_a_build_with_the_embedded_model_needs_no_torch(tmp_path, labels):
    command = [sys.executable, "-c", BUILD, str(tmp_path / "tables"), labels]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    cache = SentenceCache(tmp_path / "tables", identify(device="cpu"))
    sentences, found = zip(
        *duckdb.sql(f"select sentence, log_prob from ({cache.select()})").fetchall(), strict=True
    )
    assert len(sentences) == int(done.stdout)
    bars = re.findall(r"sentences: 100 %\|\S+ (\d+)/\1 ", done.stderr)
    assert sum(map(int, bars)) == len(sentences)
    expected = [score.log_prob for score in load_scorer().score(sentences)]
    assert found == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    "options", [{"dtype": "float64"}, {"token_budget": 64}, {"scoring": "causal"}]
)
def test_its_identity_is_the_one_that_was_asked_for(options):
    model = LazyScorer(BuildConfig.load(device="cpu", **options))
    scorer = model.load()
    assert scorer.scorer_id == model.scorer_id
    assert isinstance(scorer, OnnxScorer) == (options == {"scoring": "causal"})


def test_another_model_runs_on_torch(tmp_path):
    (tmp_path / "other").symlink_to(EMBEDDED_FOLDER)
    scorer = LazyScorer(BuildConfig.load(model=str(tmp_path / "other"), device="cpu")).load()
    assert scorer.scorer_id == identify(str(tmp_path / "other"), device="cpu")
    assert not isinstance(scorer, OnnxScorer)
