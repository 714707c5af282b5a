"""Step 6 of `Network.step`: a set's mean is computed only when an upper bound of it passes the limit.

The bound is its sum when all weights were last settled, plus |drive| times the sum of |scaled| of the synapses that can
rise.
"""

from __future__ import annotations

import numpy as np

from snnrl.engines.fused.compiler import rare
from snnrl.engines.fused.lists import lower_list, settle_list
from snnrl.engines.fused.tiles import lower_tiles, settle_tiles
from snnrl.engines.layout import BY_RULE, OF_SET, RULE, SET

SLACK = 1e-5  # of a limit, for the rounding of the bound
TINY = 1e-30  # in place of a rise of nothing


def settle(t, s, w, trial, power):
    """Bring all weights up to date and measure the sets; the drives start at zero again.

    Eligibilities, `scaled` since `power` ms ago, are then those of now.
    """
    w.weights[:] = 0.0
    w.rising[:] = 0.0
    for d in range(t.matrices.shape[0]):
        total, rise = settle_tiles(t, w, d, t.fading[t.matrices[d, BY_RULE], power])
        if t.matrices[d, OF_SET] >= 0:
            w.weights[t.matrices[d, OF_SET]] += total
            w.rising[t.matrices[d, OF_SET]] += rise
    for p in t.listed:
        total, rise = settle_list(t, s, w, trial, p, t.fading[t.projections[p, RULE], power])
        if t.projections[p, SET] >= 0:
            w.weights[t.projections[p, SET]] += total
            w.rising[t.projections[p, SET]] += rise
    w.drive[:] = 0.0
    w.reach[0] = reach_with(t, w, trial, 0.0)


def reach_with(t, w, trial, more):
    """The farthest drive up to which no set can have passed its limit, if `rising` grows by `more`."""
    reach = np.inf
    for k in range(t.set_step.shape[0]):
        limit = t.set_limit[trial, k]
        room = limit - SLACK * limit - w.weights[k]
        reach = min(reach, room / max(w.rising[k] + more, TINY) if room >= 0.0 and not t.set_always[k] else -1.0)
    return reach


@rare
def dampen(t, s, w, trial):
    """Bring all weights up to date and lower the sets whose mean is too high."""
    settle(t, s, w, trial, 0)
    over = False
    for k in range(t.set_step.shape[0]):
        over |= w.weights[k] > t.set_limit[trial, k]
    if over:
        for d in range(t.matrices.shape[0]):
            k = t.matrices[d, OF_SET]
            if k >= 0 and w.weights[k] > t.set_limit[trial, k]:
                lower_tiles(t, w, d, t.set_step[k])
        for p in t.listed:
            k = t.projections[p, SET]
            if k >= 0 and w.weights[k] > t.set_limit[trial, k]:
                lower_list(t, s, trial, p, t.set_step[k])
        settle(t, s, w, trial, 0)
