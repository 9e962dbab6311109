"""However a room is decided, it is decided alike: SQL, the mapped arrays, Python, the definitions.

Random small tables, three rules and two sources; the definitions are ``plain_decision.py``.
"""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from plain_decision import PlainDecision
from roomtables import Prediction, RoomTables, build
from roomtables.labels import LabelSpace, ObjectLabel, RoomLabel, normalise
from roomtables.online import rules
from roomtables.schemas import RULES, SOURCES, literal
from roomtables.scorer import SentenceScore
from roomtables.storage.lookup import pack_keys
from roomtables.storage.views import connect, select
from support import HashScorer, write_space

TOLERANCE = 1e-9


class SteppedScorer(HashScorer):
    """Random scores; with a step they are whole multiples of it, so that many are equal."""

    def __init__(self, seed: int, step: float) -> None:
        super().__init__(f"stepped@{seed}-{step}")
        self._step = step

    def score_of(self, sentence: str) -> SentenceScore:
        nats, tokens = super().score_of(sentence).log_prob, len(sentence.split())
        return SentenceScore(round(nats / self._step) * self._step if self._step else nats, tokens)


@dataclass(frozen=True)
class Case:
    """A label space, its scores and counts, how its tables are built, and rooms to decide."""

    space: LabelSpace
    scorer: SteppedScorer
    counts: Mapping[tuple[str, str], int]
    smoothing: float | None
    rule: str
    source: str
    prior_weight: float
    evidence_power: float
    k: int
    logged: Sequence[Sequence[str]] | None
    questions: Sequence[Sequence[str]]
    candidates: tuple[str, ...]

    def plain(self, rule: str, source: str, **more: Any) -> PlainDecision:
        """The definitions, over what the tables hold."""
        score = cache(lambda text: self.scorer.score_of(text).log_prob)
        decision = PlainDecision(
            self.space, score, self.counts, rule, source, self.prior_weight, self.evidence_power,
            k=self.k, smoothing=self.smoothing,
        )  # fmt: skip
        combinations = None
        if self.logged is not None:
            combinations = {frozenset(decision.answer(objects).objects) for objects in self.logged}
        return replace(decision, combinations=combinations, **more)

    @contextmanager
    def built(self) -> Iterator[Path]:
        """The tables folder of a build."""
        root = Path(tempfile.mkdtemp())
        try:
            with (root / "counts.csv").open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file)
                writer.writerow(["object", "room", "count"])
                writer.writerows([*pair, count] for pair, count in self.counts.items())
            lines = [json.dumps({"room_id": "1", "objects": o}) + "\n" for o in self.logged or ()]
            (root / "log.jsonl").write_text("".join(lines), encoding="utf-8")
            build(
                tables=root / "tables",
                labels=str(write_space(root, self.space)),
                scorer=self.scorer,
                counts=root / "counts.csv",
                smoothing=self.smoothing,
                rule=self.rule,
                source=self.source,
                prior_weight=self.prior_weight,
                evidence_power=self.evidence_power,
                k=self.k,
                combinations="all" if self.logged is None else str(root / "log.jsonl"),
            )
            yield root / "tables"
        finally:
            shutil.rmtree(root)


LABELS = st.text("abé '\"", min_size=1, max_size=5).map(normalise).filter(bool)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    objects = draw(st.lists(LABELS, min_size=2, max_size=5, unique=True))
    rooms = draw(st.lists(LABELS, min_size=2, max_size=5, unique=True))
    predicted = len(rooms) - draw(st.integers(0, min(1, len(rooms) - 2)))
    space = LabelSpace(
        "made",
        tuple(ObjectLabel(label, f"many {label}") for label in objects),
        tuple(RoomLabel(r, "a", (), place < predicted) for place, r in enumerate(rooms)),
    )
    pairs = st.tuples(st.sampled_from(objects), st.sampled_from(rooms))
    some = st.lists(st.sampled_from(objects), min_size=1, max_size=5, unique=True)
    return Case(
        space,
        SteppedScorer(draw(st.integers(0, 999)), draw(st.sampled_from([0.0, 0.0, 1.0]))),
        draw(st.dictionaries(pairs, st.integers(0, 9), min_size=1)),
        draw(st.sampled_from([0.0, None])),
        draw(st.sampled_from(RULES)),
        draw(st.sampled_from(SOURCES)),
        draw(st.floats(-0.5, 2)),
        draw(st.sampled_from([0.0, 1.0, 3.0]) | st.floats(0, 4)),
        draw(st.integers(1, 3)),
        draw(st.none() | st.lists(some, min_size=1, max_size=4)),
        draw(st.lists(some, min_size=2, max_size=2)),
        tuple(draw(st.lists(st.sampled_from(rooms[:predicted]), min_size=1, unique=True))),
    )


Numbers = dict[str, tuple[float, float]]


def from_sql(connection: Any, call: str) -> Numbers:
    """What a macro says of each room: what is compared, in nats, and its probability."""
    _, rows = select(connection, f"from {call}")
    compared = [row[1] for row in rows]
    assert compared == sorted(compared, reverse=True)
    return {room: (nats, p) for room, nats, p, *_ in rows}


def from_arrays(tables: RoomTables, objects: Sequence[str]) -> Numbers:
    """The same, read from the arrays of the mapped lookup."""
    lookup, decision = tables.lookup, tables.decision
    arrays = lookup.sources[decision.source]
    numbers = [[listed.label for listed in lookup.objects].index(name) for name in objects]
    predicted = [number for number, room in enumerate(lookup.rooms) if room.predicted]
    names = [lookup.rooms[number].label for number in predicted]
    chosen = [names.index(room) for room in sorted(decision.rooms or names)]
    bias = arrays.bias[chosen]
    ranks = sorted(int(arrays.ranks[number]) for number in numbers)[: lookup.k]
    (key,) = pack_keys(np.array([ranks + [0] * (lookup.k - len(ranks))]), lookup.k)
    rows = np.flatnonzero(arrays.keys == key)
    if decision.rule == "pooled" or (decision.backoff and not len(rows)):
        logits = arrays.room_logits[numbers][:, [predicted[place] for place in chosen]]
        weight = decision.prior_weight if decision.source == "proxy" else 0
        adjusted = rules.adjusted(logits, bias, weight)
        weights = rules.evidence_weights(adjusted, decision.evidence_power)
        compared = rules.evidence(adjusted, weights).sum(axis=0)
    else:
        if not len(rows):
            return {}
        compared = arrays.scores[rows[0]][chosen].astype(float)
        if decision.rule == "calibrated":
            compared = compared - decision.prior_weight * bias
    p = np.exp(rules.log_softmax(compared))
    labels = [names[place] for place in chosen]
    return dict(zip(labels, zip(compared.tolist(), p.tolist(), strict=True), strict=True))


def from_prediction(found: Prediction) -> Numbers:
    if found.compared is None:
        return {}
    compared = dict(zip(found.probabilities, found.compared.tolist(), strict=True))
    # Where rooms are as good as each other, another order of adding up may prefer another.
    assert found.room is not None
    assert compared[found.room] >= max(compared.values()) - TOLERANCE
    return {room: (compared[room], p) for room, p in found.probabilities.items()}


def agree(ways: Mapping[str, Numbers], expected: Mapping[str, float], why: object) -> None:
    """Each way has the probabilities that the definitions have, and compares the same nats."""
    reference = next(iter(ways.values()))
    for way, numbers in ways.items():
        assert {room: p for room, (_, p) in numbers.items()} == pytest.approx(
            expected, abs=TOLERANCE
        ), (way, why)
        nats = {room: value for room, (value, _) in numbers.items()}
        assert nats == pytest.approx({r: v for r, (v, _) in reference.items()}, abs=TOLERANCE), way


def sql_list(values: Sequence[str]) -> str:
    return f"[{', '.join(map(literal, values))}]"


MACROS = {"query": "answers", "calibrated": "calibrated", "pooled": "p_room_given"}


def check_tables(case: Case, published: RoomTables, connection: Any, chosen: slice) -> None:
    """Without a model: every rule and source, all rooms and some, in SQL and in Python."""
    every = list(product(RULES, SOURCES, ((), case.candidates), (True, False)))[chosen]
    for rule, source, rooms, backoff in every:
        tables = published.deciding(rule=rule, source=source, rooms=rooms, backoff=backoff)
        plain = case.plain(rule, source, rooms=rooms, backoff=backoff)
        among = f", among := {sql_list(rooms)}" if rooms else ""
        many = tables.classify_many(case.questions)
        for objects, batched in zip(case.questions, many, strict=True):
            one, expected = tables.classify(objects), plain.answer(objects)
            ways = {
                "classify": from_prediction(one),
                "classify_many": from_prediction(batched),
                "arrays": from_arrays(tables, objects),
            }
            agree(ways, expected.probabilities, (rule, source, rooms, backoff, objects))
            assert list(one.objects) == list(batched.objects) == expected.objects
            assert one.rule == batched.rule == expected.rule
        assert many.rooms == [tables.classify(objects).room for objects in case.questions]
        more = f"from_source := '{source}'{among}"
        if backoff:
            call = f"decided({sql_list(objects)}, by_rule := '{rule}', {more})"
        else:
            call = f"{MACROS[rule]}({sql_list(objects)}, {more})"
        agree(ways | {"SQL": from_sql(connection, call)}, expected.probabilities, call)


def check_as_published(case: Case, published: RoomTables, connection: Any) -> None:
    """Without a word on how to decide, SQL and Python do as the build's settings say."""
    plain = case.plain(case.rule, case.source)
    for objects in case.questions:
        ways = {
            "classify": from_prediction(published.classify(objects)),
            "SQL": from_sql(connection, f"decided({sql_list(objects)})"),
        }
        agree(ways, plain.answer(objects).probabilities, objects)


def check_model(case: Case, published: RoomTables) -> None:
    """With a model: combinations that no table holds, objects and rooms that no table lists."""
    questions = [*case.questions, [*case.questions[0], "gizmo"]]
    for rule, rooms in product(RULES, ((), (*case.candidates, "crypt"))):
        tables = published.deciding(rule=rule, source="proxy", rooms=rooms)
        plain = case.plain(rule, "proxy", rooms=rooms, model=True)
        many = tables.classify_many(questions)
        for objects, batched in zip(questions, many, strict=True):
            one, expected = tables.classify(objects), plain.answer(objects)
            ways = {"classify": from_prediction(one), "classify_many": from_prediction(batched)}
            agree(ways, expected.probabilities, (rule, rooms, objects))
            assert one.answered_by == batched.answered_by == expected.answered_by
            assert list(one.objects) == list(batched.objects) == expected.objects


def examples(most: int) -> settings:
    """Every example is built anew, which is slow: so many of them, and after a failure no search
    for a smaller one."""
    phases = [Phase.explicit, Phase.generate]
    return settings(max_examples=most, derandomize=True, deadline=None, phases=phases)


# Of the 24 ways to decide five an example, which differ in rule, source, rooms and back-off.
@examples(5)
@given(case=cases(), first=st.integers(0, 4))
def test_sql_arrays_and_python_decide_by_the_definitions(case: Case, first: int) -> None:
    check(case, slice(first, None, 5))


@pytest.mark.slow
@examples(60)
@given(case=cases())
def test_they_decide_many_rooms_by_the_definitions(case: Case) -> None:
    check(case, slice(None))


def check(case: Case, chosen: slice) -> None:
    with case.built() as folder:
        published = RoomTables.open(folder, "made", offline=True, note_misses=False)
        connection = connect(folder, published.version)
        check_tables(case, published, connection, chosen)
        check_as_published(case, published, connection)
        connection.close()
        check_model(case, RoomTables.open(folder, "made", scorer=case.scorer, note_misses=False))
