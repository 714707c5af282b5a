"""Step 6 of `Network.step`."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import barrier
from snnrl.engines.cuda.plasticity import span
from snnrl.engines.layout import SET
from snnrl.model.homeostasis import lowered


def dampen(t, least, s, w, trial):
    """Lower the sets whose mean is too high. Sums are added up in an order that depends on `lanes` alone."""
    for k in range(t.set_step.shape[0]):
        if total_weight(t, s, w, trial, k) > t.set_limit[trial, k]:
            for p in range(t.projections.shape[0]):
                if t.projections[p, SET] == k:
                    low, high = span(t, p, trial)
                    for i in range(low + w.lane, high, w.lanes):
                        s.weight[i] = lowered(s.weight[i], t.set_step[k], least[p])


def total_weight(t, s, w, trial, k):
    """The sum of a set's weights, the same in all threads, float64."""
    mine = np.float64(0.0)
    for p in range(t.projections.shape[0]):
        if t.projections[p, SET] == k:
            low, high = span(t, p, trial)
            for i in range(low + w.lane, high, w.lanes):
                mine += np.float64(s.weight[i])
    w.partial[w.lane] = mine
    half = w.lanes // 2
    while half > 0:
        barrier()
        if w.lane < half:
            w.partial[w.lane] += w.partial[w.lane + half]
        half //= 2
    barrier()
    total = w.partial[0]
    barrier()  # before it becomes another set's
    return total
