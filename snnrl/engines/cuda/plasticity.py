"""Steps 4, 5 and 7 of `Network.step`: every synapse in every ms, in the reference's order of operations."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import real
from snnrl.engines.cuda.work import BOUNDS_AT, BY, BY_WEIGHT_RULE, HEARS, SLICE
from snnrl.engines.fused.plasticity import bound
from snnrl.engines.layout import DEPRESSES, GAINS, GAINS_END, LOSSES, LOSSES_END


def load_synapses(t, s, w, trial):
    """Fetch a trial's weights and eligibilities."""
    k = w.lane
    while k < t.wiring.begins[trial, t.wiring.runs.shape[0]]:
        w.weight[k] = s.weight[t.wiring.at[trial, k]]
        w.eligibility[k] = s.eligibility[t.wiring.at[trial, k]]
        k += w.lanes


def store_synapses(t, s, w, trial):
    """Put them back where they were."""
    k = w.lane
    while k < t.wiring.begins[trial, t.wiring.runs.shape[0]]:
        s.weight[t.wiring.at[trial, k]] = w.weight[k]
        s.eligibility[t.wiring.at[trial, k]] = w.eligibility[k]
        k += w.lanes


def look_up(t, first, end, elapsed):
    """What a window gives after so many ms."""
    return t.windows[first + min(elapsed, end - 1 - first)]


def paired(t, s, w, trial, now, rule, pre, post):
    """What the pairs that this ms's spikes complete add to an eligibility."""
    depresses, rise, fall = t.rules[rule, DEPRESSES], real(0.0), real(0.0)
    if w.fired[post]:
        since = w.earlier[pre] if depresses and w.fired[pre] else s.last_spike[trial, pre]
        rise = look_up(t, t.rules[rule, GAINS], t.rules[rule, GAINS_END], now - since)
    if w.fired[pre]:
        fall = look_up(t, t.rules[rule, LOSSES], t.rules[rule, LOSSES_END], now - s.last_spike[trial, post])
    if depresses:
        return rise + fall
    return rise if w.fired[post] else fall


def learn(t, wiring, s, w, trial, now, any_fired):
    """Steps 4 and 5; each thread leaves the sum of the weights of a run that are its own in `partial`."""
    sources, targets = wiring.pre[trial], wiring.post[trial]
    for r in range(wiring.runs.shape[0]):
        signal, decay = w.signal[wiring.runs[r, HEARS]], wiring.decay[r]
        which, at = wiring.runs[r, BY_WEIGHT_RULE], wiring.runs[r, BOUNDS_AT]
        mine = np.float64(0.0)
        k, end = wiring.begins[trial, r] + w.lane, wiring.begins[trial, r + 1]
        while k < end:
            eligibility = w.eligibility[k] * decay
            if any_fired:
                pre, post = sources[k], targets[k]
                if w.fired[pre] or w.fired[post]:
                    eligibility = eligibility + paired(t, s, w, trial, now, wiring.runs[r, BY], pre, post)
            w.eligibility[k] = eligibility
            weight = bound(which, w.weight[k], eligibility * signal, t.bounds, at)
            w.weight[k] = weight
            mine += np.float64(weight)
            k += w.lanes
        w.partial[r * w.lanes + w.lane] = mine


def send(t, wiring, s, w, trial, slot):
    """Step 7: each neuron gathers what it will receive."""
    n, slots, learnt = w.lane, s.pending.shape[1], wiring.begins[trial, wiring.runs.shape[0]]
    while n < s.last_spike.shape[1]:
        k = wiring.slices[trial, n // SLICE] + n % SLICE
        end = k + SLICE * wiring.entering[trial, n]
        while k < end:
            if w.fired[wiring.source[k]]:
                later = slot + wiring.delay[k]
                later = later if later < slots else later - slots
                place = wiring.place[k]
                weight = w.weight[place] if place < learnt else s.weight[wiring.at[trial, place]]
                s.pending[trial, later, n] += weight * t.gain
            k += SLICE
        n += w.lanes
