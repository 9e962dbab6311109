"""Intervals, paired tests and calibration against plain computations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables.evaluation.statistics import (
    area_under_risk,
    bootstrap_interval,
    expected_calibration_error,
    mcnemar,
    reliability,
    risk_coverage,
)

OUTCOMES = st.lists(st.booleans(), min_size=1, max_size=40)
ANSWERS = st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=40)


def test_bootstrap_interval_is_the_normal_one_for_many_rooms():
    right = np.arange(523) < 307
    found = bootstrap_interval(right)
    half = 1.96 * math.sqrt(0.587 * 0.413 / 523)
    assert found.low == pytest.approx(307 / 523 - half, abs=0.01)
    assert found.high == pytest.approx(307 / 523 + half, abs=0.01)
    assert bootstrap_interval(right) == found
    assert bootstrap_interval(right, seed=1) != found


@given(OUTCOMES)
def test_bootstrap_interval_holds_the_mean(outcomes):
    found = bootstrap_interval(outcomes, resamples=200)
    assert 0 <= found.low <= found.high <= 1
    if len(set(outcomes)) == 1:
        assert found.low == found.high == outcomes[0]


def test_no_room_has_no_interval():
    with pytest.raises(ValueError, match="no value"):
        bootstrap_interval([])


def test_mcnemar_by_hand():
    # Nine rooms only the first got right, one only the second: 2 × (1 + 10) / 2^10.
    first = [True] * 9 + [False] + [True] * 5
    second = [False] * 9 + [True] + [True] * 5
    found = mcnemar(first, second)
    assert (found.only_first, found.only_second) == (9, 1)
    assert found.p_value == pytest.approx(2 * 11 / 1024)


@given(st.integers(0, 40), st.integers(0, 40))
def test_mcnemar_is_the_two_sided_binomial_test(only_first, only_second):
    differing = only_first + only_second
    tail = sum(math.comb(differing, n) for n in range(min(only_first, only_second) + 1))
    first = [True] * only_first + [False] * only_second + [True]
    second = [False] * only_first + [True] * only_second + [True]
    found = mcnemar(first, second)
    assert (found.only_first, found.only_second) == (only_first, only_second)
    assert found.p_value == pytest.approx(min(1.0, 2 * tail / 2**differing))


@given(OUTCOMES)
def test_mcnemar_of_equals_is_no_difference(outcomes):
    assert mcnemar(outcomes, outcomes).p_value == 1


def test_mcnemar_of_many_rooms_is_finite():
    assert mcnemar([True] * 5000, [False] * 5000).p_value == 0
    assert mcnemar([True, False] * 5000, [False, True] * 5000).p_value == 1


def test_reliability_by_hand():
    bins = reliability([0.1, 0.11, 0.95, 1.0, 0.0], [True, False, True, True, False])
    assert [(b.low, b.rooms) for b in bins] == [(0.0, 2), (0.1, 1), (0.9, 2)]
    assert bins[0].accuracy == 0.5
    assert bins[0].mean_probability == pytest.approx(0.05)
    error = (2 * 0.45 + 1 * 0.11 + 2 * 0.025) / 5
    assert expected_calibration_error(bins) == pytest.approx(error)


@given(ANSWERS)
def test_every_room_is_in_one_bin(answers):
    probability, right = zip(*answers, strict=True)
    bins = reliability(probability, right)
    assert sum(b.rooms for b in bins) == len(answers)
    assert all(b.low - 1e-12 <= b.mean_probability <= b.high + 1e-12 for b in bins)
    assert 0 <= expected_calibration_error(bins) <= 1


def test_nothing_answered_has_no_calibration():
    assert reliability([], []) == []
    assert expected_calibration_error([]) == 0
    assert risk_coverage([], [], rooms=3) == []
    assert area_under_risk([]) == 0


@given(ANSWERS)
def test_risk_coverage_is_what_each_threshold_does(answers):
    probability, right = map(np.array, zip(*answers, strict=True))
    points = risk_coverage(probability, right, rooms=len(answers) + 3)
    assert [p.min_probability for p in points] == sorted(set(probability.tolist()), reverse=True)
    for point in points:
        answered = probability >= point.min_probability
        assert point.coverage == pytest.approx(answered.sum() / (len(answers) + 3))
        assert point.accuracy == pytest.approx(right[answered].mean())


def test_the_surest_first_is_less_risk():
    good = risk_coverage([0.9, 0.8, 0.2], [True, True, False])
    bad = risk_coverage([0.9, 0.8, 0.2], [False, True, True])
    assert area_under_risk(good) < area_under_risk(bad)
