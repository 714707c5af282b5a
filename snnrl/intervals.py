"""Confidence intervals, all at CONFIDENCE: of a mean over trials, and of a fraction of trials."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

CONFIDENCE = 0.95
QUANTILE = 0.5 + CONFIDENCE / 2


def student_half(sd: Any, n: int) -> Any:
    """Half of Student's interval of the mean of n > 1 values; `sd` is their standard deviation, of any shape."""
    return stdtrit(n - 1, QUANTILE) * sd / math.sqrt(n)


def student(values: Any) -> tuple[float, float]:
    """Student's interval of the mean of an array [n]; of fewer than two values, not bounded."""
    values = np.asarray(values, float)
    if len(values) < 2:
        return -math.inf, math.inf
    mean, half = float(values.mean()), float(student_half(values.std(ddof=1), len(values)))
    return mean - half, mean + half


def wilson(p: float, n: float) -> tuple[float, float]:
    """Wilson's interval of a fraction p of n trials; it begins at 0 exactly for none, and ends at 1 for all.

    `n` may be infinite.
    """
    z = float(ndtri(QUANTILE))
    part = z / (2 * n)
    shift, half = z * part, z * math.sqrt(p * (1 - p) / n + part * part)
    return (p + (shift - half)) / (1 + 2 * shift), (p + (shift + half)) / (1 + 2 * shift)
