"""Step 6 of `Network.step`."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import PARTS, anywhere, barrier
from snnrl.engines.cuda.work import IN_SET
from snnrl.model.homeostasis import lowered


def dampen(t, wiring, w, trial):
    """Lower the sets whose mean is too high, and wait for each other."""
    sets = t.set_step.shape[0]
    if sets == 0:
        return
    barrier()
    add_up(w, wiring.runs.shape[0])
    barrier()
    mine = False
    k = w.lane
    while k < sets:
        w.over[k] = total_weight(wiring, w, k) > t.set_limit[trial, k]
        mine = mine or w.over[k]
        k += w.lanes
    if anywhere(mine):
        for r in range(wiring.runs.shape[0]):
            which = wiring.runs[r, IN_SET]
            if which >= 0 and w.over[which]:
                i, end = wiring.begins[trial, r] + w.lane, wiring.begins[trial, r + 1]
                while i < end:
                    w.weight[i] = lowered(w.weight[i], t.set_step[which], wiring.least[r])
                    i += w.lanes


def add_up(w, runs):
    """Of the sum of each run's weights, make PARTS parts of those of all threads; their order is always the same."""
    k = w.lane
    while k < runs * PARTS:
        first = k // PARTS * w.lanes + k % PARTS
        i, total = first, np.float64(0.0)
        while i < first - k % PARTS + w.lanes:
            total += w.partial[i]
            i += PARTS
        w.partial[first] = total
        k += w.lanes


def total_weight(wiring, w, k):
    """The sum of a set's weights."""
    total = np.float64(0.0)
    for r in range(wiring.runs.shape[0]):
        if wiring.runs[r, IN_SET] == k:
            for i in range(PARTS):
                total += w.partial[r * w.lanes + i]
    return total
