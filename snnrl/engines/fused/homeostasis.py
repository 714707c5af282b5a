"""Step 6 of `Network.step`: a set's mean is computed only when an upper bound of it passes the limit.

The bound is its sum at the last flush, plus |drive| times the sum of |scaled| of the synapses that can rise.
"""

from __future__ import annotations

import numpy as np

from snnrl.engines.fused.compiler import rare
from snnrl.engines.fused.plasticity import flush, row_width, synapses_of
from snnrl.engines.fused.vectors import LANES, across, as_double, bits_mask, load, select, store
from snnrl.engines.layout import MASK_AT, POST, PRE, ROW_AT, RULE, SET, SIGNAL, SIZE
from snnrl.model.homeostasis import lowered

SLACK = 1e-5  # of a limit, for the rounding of the bound


def measure_sets(t, s, w, trial):
    """Total weight of each set, and the most it can rise per unit of drive; all weights are settled."""
    w.weights[:] = 0.0
    w.rising[:] = 0.0
    for p in range(t.projections.shape[0]):
        k = t.projections[p, SET]
        if k >= 0 and t.projections[p, RULE] >= 0:
            total, rise = measure(t, s, w, trial, p)
            w.weights[k] += total
            w.rising[k] += rise


def measure(t, s, w, trial, p):
    """Sum of a projection's weights, and of |scaled| where that makes a weight rise."""
    sign = 1.0 if w.positive[t.projections[p, SIGNAL]] else -1.0
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(t.groups[t.projections[p, POST], SIZE])
        at = t.projections[p, ROW_AT]
        total = as_double(load(w.dense, at)) * 0.0
        rise = total
        for _ in range(t.groups[t.projections[p, PRE], SIZE]):
            for b in range(0, width, LANES):
                weight, upward = load(w.dense, at + b), as_double(load(w.dense, at + width + b)) * sign
                total = total + as_double(weight)
                rise = rise + select((upward > 0.0) & (weight < t.most[p]), upward, upward * 0.0)
            at += 3 * width
        return across(total), across(rise)
    low, high = synapses_of(t, p, trial)
    listed, risen = np.float64(0.0), np.float64(0.0)
    for i in range(low, high):
        listed += s.weight[i]
        risen += max(sign * s.eligibility[i], 0.0) if s.weight[i] < t.most[p] else 0.0
    return listed, risen


def may_exceed(t, w, trial, farthest, more):
    """Whether a set can have passed its limit since the last flush.

    Args:
        farthest: largest drive since then.
        more: that `rising` may still grow by.
    """
    near = False
    for k in range(t.set_step.shape[0]):
        limit = t.set_limit[trial, k]
        near |= t.set_always[k] or w.weights[k] + (w.rising[k] + more) * farthest > limit - SLACK * limit
    return near


@rare
def dampen(t, s, w, trial):
    """Bring all weights up to date and lower the sets whose mean is too high."""
    flush(t, s, w, trial)
    measure_sets(t, s, w, trial)
    over = False
    for k in range(t.set_step.shape[0]):
        over |= w.weights[k] > t.set_limit[trial, k]
    if over:
        for p in range(t.projections.shape[0]):
            set_ = t.projections[p, SET]
            if set_ >= 0 and t.projections[p, RULE] >= 0 and w.weights[set_] > t.set_limit[trial, set_]:
                lower(t, s, w, trial, p, t.set_step[set_])
        measure_sets(t, s, w, trial)


def lower(t, s, w, trial, p, step):
    """Lower every weight of projection p."""
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(t.groups[t.projections[p, POST], SIZE])
        at, mask = t.projections[p, ROW_AT], t.projections[p, MASK_AT]
        for _ in range(t.groups[t.projections[p, PRE], SIZE]):
            for b in range(0, width, LANES):
                weight = load(w.dense, at + b)
                less = lowered(weight, step, t.least[p])
                store(w.dense, at + b, select(bits_mask(w.masks[mask]), less, weight))
                mask += 1
            at += 3 * width
    else:
        low, high = synapses_of(t, p, trial)
        for i in range(low, high):
            s.weight[i] = lowered(s.weight[i], step, t.least[p])
