"""Intervals against closed forms and scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from snnrl.intervals import student, student_half, wilson

A = np.array([10.0, 14.0, 12.0, 16.0, 9.0])


def test_intervals_in_closed_form() -> None:
    low, high = student(np.array([10.0, 12.0, 14.0]))
    half = 4.302653 * 2.0 / math.sqrt(3)  # Student's t, two degrees of freedom
    assert (low, high) == pytest.approx((12.0 - half, 12.0 + half))
    z, n, p = 1.959964, 50, 0.9
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert wilson(p, n) == pytest.approx((middle - half, middle + half))


def test_students_interval_is_scipys_and_unbounded_for_one_value() -> None:
    low, high = stats.ttest_1samp(A, 0).confidence_interval(0.95)
    assert student(A) == pytest.approx((low, high))
    assert student(A[:1]) == (-math.inf, math.inf)


def test_half_an_interval_is_that_of_each_column() -> None:
    values = np.array([[1.0, 2.0], [3.0, 2.5], [5.0, 4.0]])
    halves = student_half(values.std(0, ddof=1), 3)
    for column, half in zip(values.T, halves, strict=True):
        low, high = student(column)
        assert high - low == pytest.approx(2 * half)


def test_wilsons_interval_is_scipys_and_shrinks_to_the_fraction() -> None:
    for count, n in ((0, 3), (1, 3), (41, 50), (20, 20)):
        theirs = stats.binomtest(count, n).proportion_ci(0.95, "wilson")
        assert wilson(count / n, n) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert wilson(0.3, math.inf) == (0.3, 0.3)
    for n in range(1, 100):
        assert wilson(0.0, n)[0] == 0.0
        assert wilson(1.0, n)[1] == 1.0
