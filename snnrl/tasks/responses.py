"""How the network answered stimuli over a run, from the sums of presentations and of spikes at every sample."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Series = Mapping[str, np.ndarray]  # `time` [T], `presented` and `response` [T, B, K], and others


def mean_response(series: Series, low: int, high: int) -> np.ndarray:
    """Mean response (spikes) to each stimulus between two samples, [B, K]; NaN if never shown."""
    presented = series["presented"][high] - series["presented"][low]
    response = series["response"][high] - series["response"][low]
    return np.where(presented > 0, response / np.maximum(presented, 1), np.nan)


def quarters(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Mean responses in the first and the last quarter, [B, K] each."""
    samples = len(series["time"])
    part = max(1, (samples - 1) // 4)
    return mean_response(series, 0, part), mean_response(series, samples - 1 - part, samples - 1)
