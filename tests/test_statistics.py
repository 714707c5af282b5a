"""Intervals, effect sizes and verdicts against closed forms, scipy and published examples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from snnrl.thesis.statistics import MARGIN, Sample, Share, compare_means, compare_shares, interval, welch

A = np.array([10.0, 14.0, 12.0, 16.0, 9.0])
B = np.array([11.0, 8.0, 7.0, 10.0, 9.5, 6.0])


def test_welch_is_scipys() -> None:
    theirs = stats.ttest_ind(A, B, equal_var=False).confidence_interval(0.95)
    assert welch(Sample.of(A), Sample.of(B)) == pytest.approx((theirs.low, theirs.high))


def test_interval_of_a_mean() -> None:
    low, high = stats.ttest_1samp(A, 0).confidence_interval(0.95)
    assert interval(A) == pytest.approx((low, high))
    assert interval(A[:1]) == (-math.inf, math.inf)


def test_hedges_g_by_hand() -> None:
    pooled = math.sqrt((4 * A.var(ddof=1) + 5 * B.var(ddof=1)) / 9)
    expected = (A.mean() - B.mean()) / pooled * (1 - 3 / 35)
    assert compare_means(Sample.of(A), Sample.of(B)).effect == pytest.approx(expected)


def test_newcombes_interval_is_the_published_example() -> None:
    """56 of 70 against 48 of 80: 0.0524 to 0.3339 (Newcombe 1998, table II a, method 10)."""
    found = compare_shares(Share(56, 70), Share(48, 80))
    assert (found.low, found.high) == (pytest.approx(0.0524, abs=5e-5), pytest.approx(0.3339, abs=5e-5))


@pytest.mark.parametrize(("count", "equivalent"), [(33, False), (34, False), (35, True), (45, True), (46, False)])
def test_a_fraction_is_equivalent_inside_the_published_interval(count: int, equivalent: bool) -> None:
    """82 % of 50 has the exact interval 68.6 to 91.4 %."""
    assert Share(41, 50).interval() == (pytest.approx(0.6856, abs=1e-4), pytest.approx(0.9142, abs=1e-4))
    assert compare_shares(Share(count, 50), Share(41, 50)).equivalent is equivalent


def test_a_mean_is_equivalent_only_if_both_one_sided_tests_say_so() -> None:
    theirs = Sample(100.0, 5.0, 50)
    assert compare_means(Sample(101.0, 5.0, 50), theirs).equivalent
    assert not compare_means(Sample(101.0, 60.0, 50), theirs).equivalent  # too uncertain to tell
    assert not compare_means(Sample(112.0, 5.0, 50), theirs).equivalent
    edge = theirs.mean * (1 + MARGIN) - stats.t.ppf(0.95, 98) * 1.0  # where the upper test turns; the error is 1
    assert compare_means(Sample(edge - 0.01, 5.0, 50), theirs).equivalent
    assert not compare_means(Sample(edge + 0.01, 5.0, 50), theirs).equivalent


def test_a_mean_without_a_published_spread_needs_to_lie_in_our_interval() -> None:
    half = stats.t.ppf(0.975, 19) * 2.0 / math.sqrt(20)
    assert compare_means(Sample(5.0 + half - 0.01, 2.0, 20), Sample(5.0, None, 20)).equivalent
    assert not compare_means(Sample(5.0 + half + 0.01, 2.0, 20), Sample(5.0, None, 20)).equivalent


def test_one_value_proves_nothing() -> None:
    assert not compare_means(Sample(100.0, None, 1), Sample(100.0, 5.0, 50)).equivalent
