"""Step 6 of `Network.step`."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import barrier
from snnrl.engines.fused.lists import synapses_of
from snnrl.engines.layout import SET
from snnrl.model.homeostasis import lowered


def dampen(t, wiring, w, trial):
    """Lower the sets whose mean is too high."""
    for k in range(t.set_step.shape[0]):
        if total_weight(t, wiring, w, trial, k) > t.set_limit[trial, k]:
            for p in range(t.projections.shape[0]):
                if t.projections[p, SET] == k:
                    first, last = places(t, wiring, p, trial)
                    for i in range(first + w.lane, last, w.lanes):
                        w.memory[i] = lowered(w.memory[i], t.set_step[k], wiring.least[p])


def places(t, wiring, p, trial):
    """Where a trial's weights of a projection begin and end."""
    low, high = synapses_of(t, p, trial)
    return wiring.begins[p, trial], wiring.begins[p, trial] + high - low


def total_weight(t, wiring, w, trial, k):
    """The sum of a set's weights, float64, the same in all threads; the order of additions depends on `lanes` alone."""
    mine = np.float64(0.0)
    for p in range(t.projections.shape[0]):
        if t.projections[p, SET] == k:
            first, last = places(t, wiring, p, trial)
            for i in range(first + w.lane, last, w.lanes):
                mine += np.float64(w.memory[i])
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
