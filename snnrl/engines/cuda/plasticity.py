"""Steps 4, 5 and 7 of `Network.step`: every synapse in every ms, in the reference's order of operations."""

from __future__ import annotations

from snnrl.engines.cuda.compiler import real
from snnrl.engines.fused.lists import synapses_of
from snnrl.engines.fused.plasticity import bound
from snnrl.engines.layout import (
    BOUNDS,
    DEPRESSES,
    GAINS,
    GAINS_END,
    LOSSES,
    LOSSES_END,
    RULE,
    SIGNAL,
    WEIGHT_RULE,
)


def load_synapses(t, wiring, s, w, trial):
    """Fetch a trial's weights and eligibilities."""
    for p in range(t.projections.shape[0]):
        low, high = synapses_of(t, p, trial)
        place = wiring.begins[p, trial]
        for k in range(w.lane, high - low, w.lanes):
            w.memory[place + k] = s.weight[low + k]
            w.memory[wiring.synapses + place + k] = s.eligibility[low + k]


def store_synapses(t, wiring, s, w, trial):
    """Put them back where they were."""
    for p in range(t.projections.shape[0]):
        low, high = synapses_of(t, p, trial)
        place = wiring.begins[p, trial]
        for k in range(w.lane, high - low, w.lanes):
            s.weight[low + k] = w.memory[place + k]
            s.eligibility[low + k] = w.memory[wiring.synapses + place + k]


def look_up(t, first, end, elapsed):
    """What a window gives after so many ms."""
    return t.windows[first + min(elapsed, end - 1 - first)]


def paired(t, s, w, trial, now, rule, pre, post):
    """What the pairs that this ms's spikes complete add to an eligibility."""
    depresses, rise, fall = t.rules[rule, DEPRESSES], real(0.0), real(0.0)
    if w.fired[post]:
        since = w.earlier[pre] if depresses else s.last_spike[trial, pre]
        rise = look_up(t, t.rules[rule, GAINS], t.rules[rule, GAINS_END], now - since)
    if w.fired[pre]:
        fall = look_up(t, t.rules[rule, LOSSES], t.rules[rule, LOSSES_END], now - s.last_spike[trial, post])
    if depresses:
        return rise + fall
    return rise if w.fired[post] else fall


def learn(t, wiring, s, w, trial, now, any_fired):
    """Steps 4 and 5."""
    for p in range(t.projections.shape[0]):
        rule = t.projections[p, RULE]
        if rule < 0:
            continue
        signal, decay = w.signal[t.projections[p, SIGNAL]], t.fading[rule, 1]
        which, at = t.rules[rule, WEIGHT_RULE], t.rules[rule, BOUNDS]
        low, high = synapses_of(t, p, trial)
        place = wiring.begins[p, trial]
        for k in range(w.lane, high - low, w.lanes):
            here, there = place + k, wiring.synapses + place + k
            eligibility = w.memory[there] * decay
            if any_fired:
                pre, post = t.source[low + k], t.target[low + k]
                eligibility = eligibility + paired(t, s, w, trial, now, rule, pre, post)
            w.memory[there] = eligibility
            w.memory[here] = bound(which, w.memory[here], eligibility * signal, t.bounds, at)


def send(t, wiring, s, w, trial, now):
    """Step 7: each neuron gathers what it will receive."""
    slots, size = s.pending.shape[1], s.last_spike.shape[1]
    for n in range(w.lane, size, w.lanes):
        for k in range(wiring.entering[trial * size + n], wiring.entering[trial * size + n + 1]):
            if w.fired[wiring.source[k]]:
                s.pending[trial, (now + wiring.delay[k]) % slots, n] += w.memory[wiring.place[k]] * t.gain
