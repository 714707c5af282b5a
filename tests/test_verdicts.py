"""Differences, effect sizes and verdicts against closed forms, scipy and published examples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from snnrl.thesis.verdicts import (
    MARGIN,
    Sample,
    Share,
    compare_means,
    compare_shares,
    newcombe,
    welch,
)

A = np.array([10.0, 14.0, 12.0, 16.0, 9.0])
B = np.array([11.0, 8.0, 7.0, 10.0, 9.5, 6.0])


def test_welch_is_scipys() -> None:
    theirs = stats.ttest_ind(A, B, equal_var=False).confidence_interval(0.95)
    assert welch(Sample.of(A), Sample.of(B)) == pytest.approx((theirs.low, theirs.high))


def test_hedges_g_by_hand() -> None:
    pooled = math.sqrt((4 * A.var(ddof=1) + 5 * B.var(ddof=1)) / 9)
    expected = (A.mean() - B.mean()) / pooled * (1 - 3 / 35)
    assert compare_means(Sample.of(A), Sample.of(B)).effect == pytest.approx(expected)


def test_newcombes_interval_is_the_published_example() -> None:
    """56 of 70 against 48 of 80: 0.0524 to 0.3339 (Newcombe 1998, table II a, method 10)."""
    found = compare_shares(Share(56, 70), Share(48, 80))
    assert (found.low, found.high) == (pytest.approx(0.0524, abs=5e-5), pytest.approx(0.3339, abs=5e-5))


def test_a_mean_is_equivalent_where_the_whole_interval_is_within_the_margin() -> None:
    theirs = Sample(100.0, 5.0, 50)
    half = stats.t.ppf(0.975, 98) * 1.0  # the error is 1
    edge = 100.0 * (1 + MARGIN) - half
    assert compare_means(Sample(edge - 0.01, 5.0, 50), theirs).verdict == "equivalent"  # though it excludes zero
    assert compare_means(Sample(edge + 0.01, 5.0, 50), theirs).verdict == "differs"
    assert compare_means(Sample(101.0, 60.0, 50), theirs).verdict == "inconclusive"  # too uncertain to tell
    assert compare_means(Sample(120.0, 60.0, 50), theirs).verdict == "differs"
    assert compare_means(Sample(200.0 - edge + 0.01, 5.0, 50), theirs).verdict == "equivalent"  # below, as above
    assert compare_means(Sample(200.0 - edge - 0.01, 5.0, 50), theirs).verdict == "differs"


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"),
    [
        (Share(0, 50), Share(0, 50), "equivalent"),
        (Share(0, 20), Share(0, 20), "inconclusive"),  # up to 16 points apart for all we know
        (Share(3, 3), Share(50, 50), "inconclusive"),
        (Share(2, 3), Share(41, 50), "inconclusive"),
        (Share(41, 50), Share(41, 50), "inconclusive"),  # no number of ours would do
        (Share(35, 50), Share(48, 50), "differs"),
        (Share(990, 1000), Share(50, 50), "equivalent"),
    ],
)
def test_verdicts_on_fractions(ours: Share, theirs: Share, verdict: str) -> None:
    assert compare_shares(ours, theirs).verdict == verdict


def test_an_unpublished_spread_is_taken_to_be_ours_over_the_published_trials() -> None:
    assert compare_means(Sample(5.2, 2.0, 20), Sample(5.1, None, 20)).verdict == "inconclusive"
    found = compare_means(Sample(5.2, 0.2, 12), Sample(5.1, None, 20))
    assert (found.low, found.high) == pytest.approx(welch(Sample(5.2, 0.2, 12), Sample(5.1, 0.2, 20)))
    assert found.verdict == "equivalent"
    assert math.isnan(found.effect)


def test_values_that_are_too_few_or_all_alike_prove_nothing() -> None:
    theirs = Sample(100.0, 5.0, 50)
    assert compare_means(Sample(100.0, None, 1), theirs).verdict == "inconclusive"
    assert compare_means(Sample(5.1, 0.0, 3), Sample(5.1, None, 20)).verdict == "inconclusive"
    alike = compare_means(Sample(100.0, 0.0, 2), theirs)  # by chance: they say nothing of the spread
    assert (alike.low, alike.high) == pytest.approx(welch(Sample(100.0, 5.0, 2), theirs))


def test_a_small_sample_is_no_success_by_being_small() -> None:
    """Mean and range alike: what 10 or 50 values show, 2, 3 or 5 do not."""
    theirs, verdicts = Sample(100.0, 10.0, 50), []
    for n in (2, 3, 5, 10, 50):
        values = 102.0 + 15.0 * np.linspace(-1.0, 1.0, n)
        verdicts.append(compare_means(Sample.of(values), theirs).verdict)
    assert verdicts == ["inconclusive"] * 3 + ["equivalent"] * 2


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(Sample(492.0, 133.8, 50), Sample(446.7, 103.4, 50)), (Sample(1414.0, 189.4, 3), Sample(1418.0, 77.1, 50))],
)
def test_trials_needed_for_a_mean_are_the_least_whose_interval_fits(ours: Sample, theirs: Sample) -> None:
    found = compare_means(ours, theirs).trials_needed

    def fits(n: float) -> bool:
        return compare_means(Sample(theirs.mean, ours.sd, n), theirs).verdict == "equivalent"

    assert [n for n in range(2, 200) if fits(n)] == list(range(int(found), 200))


@pytest.mark.parametrize(("ours", "theirs"), [(Share(0, 3), Share(0, 50)), (Share(49, 50), Share(50, 50))])
def test_trials_needed_for_a_fraction_are_the_least_whose_interval_fits(ours: Share, theirs: Share) -> None:
    found, p, q = compare_shares(ours, theirs).trials_needed, ours.mean, theirs.mean

    def fits(n: int) -> bool:
        low, high = newcombe(p, n, q, theirs.n)
        return max(p - q - low, high - p + q) < MARGIN

    assert [n for n in range(2, 200) if fits(n)] == list(range(int(found), 200))


def test_no_number_of_trials_makes_up_for_too_few_published_ones() -> None:
    assert compare_shares(Share(0, 20), Share(0, 20)).trials_needed == math.inf
    assert compare_shares(Share(0, 20), Share(0, 34)).trials_needed == math.inf
    assert compare_shares(Share(0, 20), Share(0, 35)).trials_needed < math.inf  # Wilson's 9.9 points are below 10
    assert compare_means(Sample(5.7, 1.66, 20), Sample(5.1, None, 20)).trials_needed == math.inf
    assert math.isnan(compare_means(Sample(5.7, None, 1), Sample(5.1, None, 20)).trials_needed)
