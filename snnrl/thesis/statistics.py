"""Comparisons with published summaries: intervals, effect sizes, and the verdict by a rule fixed beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
MARGIN = 0.10  # of the published mean: a smaller difference counts as none
RULE = (
    f"A mean is equivalent if two one-sided Welch tests (5 %) exclude a difference of {MARGIN:.0%} of the published "
    "mean or more; a mean published without its spread, if it lies within our 95 % interval; a fraction of trials, "
    "if ours lies within the published one's 95 % interval (Clopper-Pearson). Everything else differs."
)


@dataclass(frozen=True)
class Sample:
    """Mean, standard deviation and number of independent values; no deviation where none was published."""

    mean: float
    sd: float | None
    n: int

    @classmethod
    def of(cls, values: Any) -> Sample:
        """Of an array of finite values."""
        values = np.asarray(values, float)
        return cls(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else None, len(values))

    @property
    def variance(self) -> float:
        """Of the mean."""
        return (self.sd or 0.0) ** 2 / self.n


@dataclass(frozen=True)
class Share:
    """So many trials out of n."""

    count: int
    n: int

    @property
    def mean(self) -> float:
        return self.count / self.n

    def interval(self, method: str = "exact") -> tuple[float, float]:
        low, high = stats.binomtest(self.count, self.n).proportion_ci(CONFIDENCE, method)
        return float(low), float(high)


@dataclass(frozen=True)
class Difference:
    """Ours less theirs, with a 95 % interval, an effect size (Hedges g; Cohen h for shares) and a verdict."""

    value: float
    low: float
    high: float
    effect: float
    equivalent: bool


def interval(values: Any) -> tuple[float, float]:
    """Student's 95 % interval of the mean of an array; of fewer than two values, not bounded."""
    values = np.asarray(values, float)
    if len(values) < 2:
        return -math.inf, math.inf
    half = stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)


def welch(ours: Sample, theirs: Sample, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Welch's interval of the difference of two means; both samples need a deviation."""
    variance = ours.variance + theirs.variance
    if variance == 0:
        return ours.mean - theirs.mean, ours.mean - theirs.mean
    freedom = variance**2 / sum(s.variance**2 / (s.n - 1) for s in (ours, theirs) if s.n > 1)
    half = float(stats.t.ppf(0.5 + confidence / 2, freedom)) * math.sqrt(variance)
    return ours.mean - theirs.mean - half, ours.mean - theirs.mean + half


def compare_means(ours: Sample, theirs: Sample) -> Difference:
    """By RULE; with fewer than two values of ours nothing is equivalent."""
    difference = ours.mean - theirs.mean
    if ours.sd is None or ours.n < 2:
        return Difference(difference, -math.inf, math.inf, math.nan, False)
    if theirs.sd is None:
        low, high = welch(ours, Sample(theirs.mean, 0.0, theirs.n))
        return Difference(difference, low, high, math.nan, low <= 0 <= high)
    freedom = ours.n + theirs.n - 2
    pooled = math.sqrt(((ours.n - 1) * ours.sd**2 + (theirs.n - 1) * theirs.sd**2) / freedom)
    hedges = difference / pooled * (1 - 3 / (4 * freedom - 1)) if pooled else math.nan
    low, high = welch(ours, theirs)
    within = welch(ours, theirs, 2 * CONFIDENCE - 1)  # two one-sided tests at 5 %
    margin = MARGIN * abs(theirs.mean)
    return Difference(difference, low, high, hedges, -margin < within[0] and within[1] < margin)


def compare_shares(ours: Share, theirs: Share) -> Difference:
    """By RULE; the interval of the difference is Newcombe's, from the two Wilson intervals."""
    (low1, high1), (low2, high2) = ours.interval("wilson"), theirs.interval("wilson")
    p, q = ours.mean, theirs.mean
    low = p - q - math.hypot(p - low1, high2 - q)
    high = p - q + math.hypot(high1 - p, q - low2)
    effect = 2 * math.asin(math.sqrt(p)) - 2 * math.asin(math.sqrt(q))
    published = theirs.interval()
    return Difference(p - q, low, high, effect, published[0] <= p <= published[1])
