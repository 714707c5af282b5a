"""Step 6 of `Network.step`."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import WARP
from snnrl.engines.cuda.shape import LANES, RUNS, SETS
from snnrl.engines.cuda.work import IN_SET
from snnrl.model.homeostasis import lowered


def dampen(t, wiring, w, trial):
    """Lower the sets whose mean is too high; returns whether any is.

    Every thread adds up the sums of all warps, which is quicker than to wait for one.
    """
    any_lowered = False
    for k in range(SETS):
        if total_weight(wiring, w, k) > t.set_limit[trial, k]:
            lower(t, wiring, w, trial, k)
            any_lowered = True
    return any_lowered


def total_weight(wiring, w, k):
    """The sum of a set's weights."""
    warps, total = LANES // WARP, np.float64(0.0)
    for r in range(RUNS):
        if wiring.runs[r, IN_SET] == k:
            for i in range(r * warps, (r + 1) * warps):
                total += w.partial[i]
    return total


def lower(t, wiring, w, trial, k):
    """Lower a set's weights; each thread those that are its own."""
    for r in range(RUNS):
        if wiring.runs[r, IN_SET] == k:
            i, end = wiring.begins[trial, r] + w.lane, wiring.begins[trial, r + 1]
            while i < end:
                w.weight[i] = lowered(w.weight[i], t.set_step[k], wiring.least[r])
                i += LANES
