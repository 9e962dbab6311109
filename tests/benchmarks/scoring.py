"""Sentences per second of roomtables and its peers, in CPU time on one thread: one table.

Run ``python tests/benchmarks/scoring.py`` (``--quick`` for fewer sentences). Peers come with
``pip install 'roomtables[bench]'``; one that is absent or broken is reported, not skipped over.
The bound is the time of the matrix products alone (torch's default ones), for the distinct inner
trie nodes, each product at the shape in which it is run.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["RAYON_NUM_THREADS"] = "1"

import torch
import transformers

from roomtables.labels import LabelSpace
from roomtables.lm import load_scorer
from roomtables.lm.folders import EMBEDDED_FOLDER
from roomtables.lm.scorer import SentenceScorer
from roomtables.onnx_lm import MODEL_FILE, OnnxScorer
from roomtables.packing.sequences import sort_sequences
from roomtables.packing.trie import build_trie
from roomtables.sentences import Template

ROOT = Path(__file__).parents[2]
LABELS = LabelSpace.load(ROOT / "pipeline" / "labels" / "mpcat40")
BATCH = 32
Method = Callable[[Path, Sequence[str]], Callable[[], Sequence[float]]]


def sentences(k: int, combinations: int, objects: int | None = None) -> list[str]:
    """Query sentences in the order of a build: the first combinations, every room."""
    template = Template()
    chosen = itertools.combinations(LABELS.objects[:objects], k)
    return [
        text
        for combination in itertools.islice(chosen, combinations)
        for text in template.compose(combination, LABELS.predicted_rooms)
    ]


def cpu_seconds(run: Callable[[], Any], repeats: int = 1) -> float:
    """Median CPU seconds, after a call that warms up where there are several."""
    if repeats > 1:
        run()
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        taken.append(time.process_time() - began)
    return sorted(taken)[len(taken) // 2]


# Each method loads a model from its folder and returns a function that scores the sentences.


def _plain(folder: Path) -> tuple[Any, Any]:
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    tokenizer.pad_token = tokenizer.eos_token or tokenizer.convert_ids_to_tokens(0)
    model = transformers.AutoModelForCausalLM.from_pretrained(folder, dtype=torch.float32)
    return tokenizer, model.eval()


@torch.inference_mode()
def _batch_scores(tokenizer: Any, model: Any, texts: list[str]) -> list[float]:
    batch = tokenizer(texts, return_tensors="pt", padding=True)
    ids, mask = batch["input_ids"], batch["attention_mask"]
    logits = model(input_ids=ids, attention_mask=mask).logits[:, :-1].float()
    scores = torch.log_softmax(logits, -1).gather(2, ids[:, 1:, None])[..., 0]
    return list((scores * mask[:, 1:]).sum(1).tolist())


def naive(folder: Path, texts: Sequence[str]) -> Callable[[], Sequence[float]]:
    tokenizer, model = _plain(folder)
    return lambda: [_batch_scores(tokenizer, model, [text])[0] for text in texts]


def transformers_batched(folder: Path, texts: Sequence[str]) -> Callable[[], Sequence[float]]:
    tokenizer, model = _plain(folder)

    def run() -> Sequence[float]:
        order = sorted(range(len(texts)), key=lambda index: len(texts[index]))
        scores = [0.0] * len(texts)
        for start in range(0, len(order), BATCH):
            rows = order[start : start + BATCH]
            found = _batch_scores(tokenizer, model, [texts[row] for row in rows])
            for row, score in zip(rows, found, strict=True):
                scores[row] = score
        return scores

    return run


def minicons(folder: Path, texts: Sequence[str]) -> Callable[[], Sequence[float]]:
    from minicons.scorer import IncrementalLMScorer

    tokenizer, model = _plain(folder)
    scorer = IncrementalLMScorer(model, "cpu", tokenizer=tokenizer)

    def run() -> Sequence[float]:
        return [
            score
            for start in range(0, len(texts), BATCH)
            for score in scorer.sequence_score(
                list(texts[start : start + BATCH]),
                reduction=lambda values: values.sum(0).item(),
                bos_token=False,
            )
        ]

    return run


def lm_evaluation_harness(folder: Path, texts: Sequence[str]) -> Callable[[], Sequence[float]]:
    from lm_eval.api.instance import Instance
    from lm_eval.models.huggingface import HFLM

    tokenizer, network = _plain(folder)
    model = HFLM(pretrained=network, tokenizer=tokenizer, batch_size=BATCH, device="cpu")
    # Context and continuation: the first token, which has no context of its own, and the rest.
    cut = [len(tokenizer.decode(tokenizer(text)["input_ids"][:1])) for text in texts]
    requests = [
        Instance("loglikelihood", {}, (text[:at], text[at:]), index)
        for index, (text, at) in enumerate(zip(texts, cut, strict=True))
    ]
    return lambda: [score for score, _ in model.loglikelihood(requests, disable_tqdm=True)]


def ctranslate2(folder: Path, texts: Sequence[str]) -> Callable[[], Sequence[float]]:
    import ctranslate2 as peer

    converted = folder.parent / f"{folder.name}-ctranslate2"
    if not converted.is_dir():
        peer.converters.TransformersConverter(str(folder)).convert(str(converted))
        config = converted / "config.json"  # it writes null for absent tokens, and cannot read it
        settings = json.loads(config.read_text())
        for key, value in settings.items():
            if key.endswith("_token") and value is None:
                settings[key] = "<absent>"
        config.write_text(json.dumps(settings))
    generator = peer.Generator(
        str(converted), compute_type="float32", intra_threads=1, inter_threads=1
    )
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)

    def run() -> Sequence[float]:
        pieces = [tokenizer.convert_ids_to_tokens(tokenizer(text)["input_ids"]) for text in texts]
        results = generator.score_batch(pieces, max_batch_size=BATCH)
        return [sum(result.log_probs) for result in results]

    return run


PEERS: dict[str, Method] = {
    "transformers, padded, batch 32": transformers_batched,
    "minicons, batch 32": minicons,
    "lm-evaluation-harness, batch 32": lm_evaluation_harness,
    "CTranslate2 float32, batch 32": ctranslate2,
}


def bound_seconds(scorer: SentenceScorer, texts: Sequence[str]) -> float:
    """CPU seconds of the matrix products alone, for the distinct inner nodes of the trie."""
    backend: Any = scorer.backend
    nodes = len(build_trie(sort_sequences(*backend.encode(texts))[0]).token)
    rows = min(nodes, scorer.token_budget)
    shapes = Counter(_linear_shapes(backend.forward.model))
    seconds = 0.0
    for (inputs, outputs), count in shapes.items():
        hidden, weight = torch.randn(rows, inputs), torch.randn(outputs, inputs)
        out = torch.empty(rows, outputs)
        product = cpu_seconds(lambda h=hidden, w=weight, o=out: torch.mm(h, w.t(), out=o), 7)
        seconds += product * count
    return seconds * nodes / rows


def _linear_shapes(model: Any) -> Iterator[tuple[int, int]]:
    for module in model.modules():
        if isinstance(module, torch.nn.Linear):
            yield module.in_features, module.out_features
        elif type(module).__name__ == "Conv1D":
            yield module.nx, module.nf


def compare(title: str, folder: Path, combinations: int, peers: int, repeats: int) -> None:
    """One table: every method on 3-object combinations, and how far its scores are apart."""
    texts = sentences(3, combinations)
    few = texts[:: max(1, len(texts) // 40)][:40]
    some = texts[: peers * len(LABELS.predicted_rooms)]
    run = naive(folder, few)
    expected = run()
    base = len(few) / cpu_seconds(run, 3)
    scorer = load_scorer(str(folder))
    ours = len(texts) / cpu_seconds(lambda: scorer.score(texts), repeats)
    apart = max(
        abs(score.log_prob - other)
        for score, other in zip(scorer.score(few), expected, strict=True)
    )
    limit = len(texts) / bound_seconds(scorer, texts)
    print(f"\n{title}: {len(texts):,} sentences, strategy {scorer.strategy}")
    print(f"{'method':34} {'sentences/s':>12} {'ratio':>7}  note")
    _line("one forward per sentence", base, base, f"{len(few)} sentences")
    best = 0.0
    for name, method in PEERS.items():
        try:
            score = method(folder, some)
            speed = len(some) / cpu_seconds(score, 3)
        except Exception as error:  # a peer's fault is a line of the table
            print(f"{name:34} {'-':>12} {'-':>7}  {type(error).__name__}: {str(error)[:60]!r}")
            continue
        best = max(best, speed)
        _line(name, speed, base, f"{len(some)} sentences")
    _line("roomtables", ours, base, f"at most {apart:.1g} nats from one forward per sentence")
    if (folder / MODEL_FILE).is_file():
        of_file = OnnxScorer.open(folder)
        speed = len(texts) / cpu_seconds(lambda: of_file.score(texts), repeats)
        _line("roomtables, from the ONNX file", speed, base, "as a build on a CPU scores")
    _line("bound: matrix products alone", limit, base, f"roomtables reaches {ours / limit:.0%}")
    if best:
        print(f"{'roomtables / best peer':34} {'':12} {ours / best:6.1f}x")


def _line(name: str, speed: float, base: float, note: str) -> None:
    print(f"{name:34} {speed:12,.1f} {speed / base:6.1f}x  {note}", flush=True)


def growth(folder: Path, combinations: int) -> None:
    """How cost grows with the objects in a sentence, and with those of the label space."""
    scorer = load_scorer(str(folder))
    encode: Any = scorer.backend.encode
    print(
        f"\n{'k':>2} {'objects':>8} {'sentences':>10} {'tokens':>9} {'run':>8} {'sentences/s':>12}"
    )
    for k, objects in [(1, 35), (2, 35), (3, 35), (4, 35), (3, 10), (3, 20)]:
        texts = sentences(k, combinations, objects)
        encoded = encode(texts)
        nodes = len(build_trie(sort_sequences(*encoded)[0]).token)
        tokens = int(encoded.tokens.lengths.sum())
        speed = len(texts) / cpu_seconds(lambda t=texts: scorer.score(t))
        print(
            f"{k:2} {objects:8} {len(texts):10,} {tokens:9,} {nodes:8,} {speed:12,.0f}", flush=True
        )


def save_gpt2(folder: Path) -> Path:
    """GPT-2's configuration with random weights, and its tokenizer, or one trained here."""
    torch.manual_seed(0)
    transformers.GPT2LMHeadModel(transformers.GPT2Config()).save_pretrained(folder)
    shared = Path(os.environ.get("ROOMTABLES_SHARED", ROOT.parent / "shared"))
    vocabulary = shared / "data" / "gpt2_tokenizer"
    if vocabulary.is_dir():
        tokenizer = transformers.GPT2TokenizerFast(
            vocab=str(vocabulary / "vocab.json"), merges=str(vocabulary / "merges.txt")
        )
    else:
        tokenizer = transformers.AutoTokenizer.from_pretrained(EMBEDDED_FOLDER)
    tokenizer.save_pretrained(folder)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sentences")
    parser.add_argument("--model", choices=["gpt2", "household-lm"], help="one model alone")
    options = parser.parse_args()
    torch.set_num_threads(1)
    transformers.logging.set_verbosity_error()
    transformers.logging.disable_progress_bar()
    scale = 1 if options.quick else 4
    with tempfile.TemporaryDirectory() as scratch:
        if options.model != "household-lm":
            gpt2 = save_gpt2(Path(scratch) / "gpt2-124m")
            compare("GPT-2, 124M random weights", gpt2, 50 * scale, 1, 1)
        if options.model != "gpt2":
            embedded = Path(scratch) / EMBEDDED_FOLDER.name
            embedded.symlink_to(EMBEDDED_FOLDER)
            compare("household-lm", embedded, 200 * scale, 4 * scale, 3)
            growth(embedded, 200 * scale)


if __name__ == "__main__":
    main()
