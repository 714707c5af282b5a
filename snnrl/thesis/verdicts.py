"""Comparisons with published summaries: intervals, effect sizes, and a verdict that never flatters small samples."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats
from scipy.special import stdtrit

from snnrl.intervals import CONFIDENCE, QUANTILE, wilson

MARGIN = 0.10  # of a published mean, or of all trials for a fraction: a smaller difference counts as none
RULE = (
    f"A cell is equivalent if the whole {100 * CONFIDENCE:g} % interval of the difference, ours less the published "
    f"value, lies within {100 * MARGIN:g} % of a published mean or {100 * MARGIN:g} percentage points of a fraction "
    f"(equivalence by interval inclusion: two one-sided tests, TOST, at {50 * (1 - CONFIDENCE):.2g} % each). It "
    "differs if it is not equivalent and that interval excludes zero. Else it is inconclusive: never a success. "
    "The interval is Welch's for means and Newcombe's for fractions, so that the uncertainty of the published value is "
    "part of it; a mean published without its SD is taken to have ours over the published number of trials. Trials "
    "needed: the least number of ours with which, given our SD or fraction, the interval would fit into the margin if "
    "there were no difference at all; where the published trials alone make it too wide, none would do."
)


@dataclass(frozen=True)
class Sample:
    """Mean, standard deviation and number of independent values; no deviation where none was published."""

    mean: float
    sd: float | None
    n: float  # infinite in a limit

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


@dataclass(frozen=True)
class Difference:
    """Ours less theirs, judged by RULE.

    Attributes:
        value, low, high: the difference and its 95 % interval.
        effect: its size, Hedges' g for means and Cohen's h for shares; nan where a spread is unknown.
        margin: a smaller difference counts as none.
        trials_needed: of ours, for equivalence to be possible; inf where no number would do, nan where unknown.
    """

    value: float
    low: float
    high: float
    effect: float
    margin: float
    trials_needed: float

    @property
    def verdict(self) -> str:
        if -self.margin < self.low and self.high < self.margin:
            return "equivalent"
        return "inconclusive" if self.low <= 0 <= self.high else "differs"


def welch(ours: Sample, theirs: Sample) -> tuple[float, float]:
    """Welch's interval of the difference of two means; both samples need a deviation."""
    variance = ours.variance + theirs.variance
    if variance == 0:
        return ours.mean - theirs.mean, ours.mean - theirs.mean
    freedom = variance**2 / sum(s.variance**2 / (s.n - 1) for s in (ours, theirs) if s.n > 1)
    half = float(stdtrit(freedom, QUANTILE)) * math.sqrt(variance)
    return ours.mean - theirs.mean - half, ours.mean - theirs.mean + half


def p_greater(more: Any, less: Any) -> float:
    """How likely (p) such a lead of one sample over another is if their means are equal: Welch's one-sided test."""
    return float(stats.ttest_ind(more, less, equal_var=False, alternative="greater").pvalue)


def newcombe(p: float, n: float, q: float, m: float) -> tuple[float, float]:
    """Newcombe's interval of the difference of two fractions, p of n and q of m, from their Wilson intervals."""
    (low1, high1), (low2, high2) = wilson(p, n), wilson(q, m)
    return p - q - math.hypot(p - low1, high2 - q), p - q + math.hypot(high1 - p, q - low2)


def compare_means(ours: Sample, theirs: Sample) -> Difference:
    """By RULE; a spread that is unpublished, or zero in ours, is taken to be the other's.

    With fewer than two values of ours, or no spread at all, the interval is unbounded.
    """
    difference, margin = ours.mean - theirs.mean, MARGIN * abs(theirs.mean)
    if ours.n < 2 or not (ours.sd or theirs.sd):
        return Difference(difference, -math.inf, math.inf, math.nan, margin, math.nan)
    mine, yours = replace(ours, sd=ours.sd or theirs.sd), replace(theirs, sd=theirs.sd or ours.sd)
    low, high = welch(mine, yours)

    def half_width(n: float) -> float:
        return 0.5 * float(np.ptp(welch(replace(mine, n=n), yours)))

    effect = hedges(mine, yours) if theirs.sd is not None else math.nan
    return Difference(difference, low, high, effect, margin, trials_needed(half_width, margin))


def hedges(ours: Sample, theirs: Sample) -> float:
    """Hedges' g of two samples, not both without a deviation."""
    freedom = ours.n + theirs.n - 2
    pooled = math.sqrt(sum((s.n - 1) * (s.sd or 0.0) ** 2 for s in (ours, theirs)) / freedom)
    return (ours.mean - theirs.mean) / pooled * (1 - 3 / (4 * freedom - 1))


def compare_shares(ours: Share, theirs: Share) -> Difference:
    """By RULE."""
    p, q = ours.mean, theirs.mean
    low, high = newcombe(p, ours.n, q, theirs.n)

    def half_width(n: float) -> float:
        return max(abs(bound - (p - q)) for bound in newcombe(p, n, q, theirs.n))

    effect = 2 * math.asin(math.sqrt(p)) - 2 * math.asin(math.sqrt(q))
    return Difference(p - q, low, high, effect, MARGIN, trials_needed(half_width, MARGIN))


def trials_needed(half_width: Callable[[float], float], margin: float) -> float:
    """The least n >= 2 whose `half_width`, falling with n, is below the margin; inf if even its limit is not."""
    if half_width(math.inf) >= margin:
        return math.inf
    enough = 2
    while half_width(enough) >= margin:
        enough *= 2
    candidates = range(2, enough + 1)
    return candidates[bisect_left(candidates, True, key=lambda n: half_width(n) < margin)]
