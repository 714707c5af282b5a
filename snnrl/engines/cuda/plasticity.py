"""Steps 4, 5 and 7 of `Network.step`: every synapse in every ms, in the reference's order of operations."""

from __future__ import annotations

import numpy as np

from snnrl.engines.cuda.compiler import WARP, lowest, real, sum_of_warp
from snnrl.engines.cuda.shape import LANES, NEURONS, PHASES, RUNS, SLOTS, WORDS
from snnrl.engines.cuda.work import BOUNDS_AT, BY, BY_WEIGHT_RULE, HEARS, REST, WORD
from snnrl.engines.fused.plasticity import bound
from snnrl.engines.layout import DEPRESSES, GAINS, GAINS_END, LOSSES, LOSSES_END


def load_synapses(t, s, w, trial):
    """Fetch a trial's weights and eligibilities."""
    k = w.lane
    while k < t.wiring.begins[trial, RUNS]:
        w.weight[k] = s.weight[t.wiring.at[trial, k]]
        w.eligibility[k] = s.eligibility[t.wiring.at[trial, k]]
        k += LANES


def store_synapses(t, s, w, trial):
    """Put them back where they were."""
    k = w.lane
    while k < t.wiring.begins[trial, RUNS]:
        s.weight[t.wiring.at[trial, k]] = w.weight[k]
        s.eligibility[t.wiring.at[trial, k]] = w.eligibility[k]
        k += LANES


def look_up(t, first, end, elapsed):
    """What a window gives after so many ms."""
    return t.windows[first + min(elapsed, end - 1 - first)]


def has_fired(w, base, n):
    """Whether a neuron has fired in this ms, whose spikes are from `base` on."""
    return (w.fired[base + (n >> WORD)] >> np.uint32(n & REST)) & np.uint32(1) != 0


def paired(t, s, w, trial, now, rule, pre, post, pre_fired, post_fired):
    """What the pairs that this ms's spikes complete add to an eligibility."""
    depresses, rise, fall = t.rules[rule, DEPRESSES], real(0.0), real(0.0)
    if post_fired:
        since = w.earlier[pre] if depresses and pre_fired else s.last_spike[trial, pre]
        rise = look_up(t, t.rules[rule, GAINS], t.rules[rule, GAINS_END], now - since)
    if pre_fired:
        fall = look_up(t, t.rules[rule, LOSSES], t.rules[rule, LOSSES_END], now - s.last_spike[trial, post])
    if depresses:
        return rise + fall
    return rise if post_fired else fall


def learn(t, wiring, s, w, trial, now, any_fired, base):
    """Steps 4 and 5; each warp leaves the sum of the weights of a run that are its own in `partial`."""
    for r in range(RUNS):
        if any_fired:
            mine = learn_pairs(t, wiring, s, w, trial, now, base, r)
        else:
            mine = learn_quietly(t, wiring, w, trial, r)
        mine = sum_of_warp(mine)
        if w.lane % WARP == 0:
            w.partial[(r * LANES + w.lane) // WARP] = mine


def learn_quietly(t, wiring, w, trial, r):
    """A run in a ms without spikes; returns the sum of this thread's weights."""
    signal, decay = w.signal[wiring.runs[r, HEARS]], wiring.decay[r]
    which, at = wiring.runs[r, BY_WEIGHT_RULE], wiring.runs[r, BOUNDS_AT]
    mine = np.float64(0.0)
    k, end = np.uint32(wiring.begins[trial, r] + w.lane), np.uint32(wiring.begins[trial, r + 1])
    while k < end:
        mine += turn(t, w, k, w.eligibility[k] * decay, signal, which, at)
        k = np.uint32(k + LANES)
    return mine


def learn_pairs(t, wiring, s, w, trial, now, base, r):
    """The same in a ms with spikes, which begin at `base`."""
    signal, decay = w.signal[wiring.runs[r, HEARS]], wiring.decay[r]
    which, at = wiring.runs[r, BY_WEIGHT_RULE], wiring.runs[r, BOUNDS_AT]
    sources, targets, rule = wiring.pre[trial], wiring.post[trial], wiring.runs[r, BY]
    mine = np.float64(0.0)
    k, end = np.uint32(wiring.begins[trial, r] + w.lane), np.uint32(wiring.begins[trial, r + 1])
    while k < end:
        eligibility = w.eligibility[k] * decay
        pre, post = sources[k], targets[k]
        pre_fired, post_fired = has_fired(w, base, pre), has_fired(w, base, post)
        if pre_fired or post_fired:
            eligibility = eligibility + paired(t, s, w, trial, now, rule, pre, post, pre_fired, post_fired)
        mine += turn(t, w, k, eligibility, signal, which, at)
        k = np.uint32(k + LANES)
    return mine


def turn(t, w, k, eligibility, signal, which, at):
    """Keep a synapse's eligibility and what its weight becomes by it, which is returned."""
    w.eligibility[k] = eligibility
    weight = bound(which, w.weight[k], eligibility * signal, t.bounds, at)
    w.weight[k] = weight
    return np.float64(weight)


def send(t, wiring, s, w, trial, slot, base):
    """Step 7: spike by spike, each neuron takes what it will receive."""
    for phase in range(PHASES):
        for i in range(WORDS):
            word = w.fired[base + i]
            while word != 0:
                pre = (i << WORD) + lowest(word)
                word &= word - np.uint32(1)
                if wiring.row_of[phase, pre] >= 0:
                    send_spike(t, wiring, s, w, trial, slot, wiring.row_of[phase, pre])


def send_spike(t, wiring, s, w, trial, slot, row):
    """What a neuron's spike does to those which it reaches in one phase."""
    n = w.lane
    while n < NEURONS:
        found = wiring.rows[trial, row, n]
        if found > 0:
            place, later = int(found) - 1, slot
            if SLOTS > 1:
                later += wiring.delay[trial, place]
                later = later if later < SLOTS else later - SLOTS
            weight = w.weight[place] if place < wiring.begins[trial, RUNS] else s.weight[wiring.at[trial, place]]
            s.pending[trial, later, n] += weight * t.gain
        n += LANES
