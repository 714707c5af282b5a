"""`Network.step` for one trial at a time, compiled and event-driven.

The results are those of `Network.step` to rounding; all tensors are up to date after every block of ms.
"""

from __future__ import annotations

from snnrl.engines.fused.compiler import rare
from snnrl.engines.fused.homeostasis import dampen, may_exceed, measure_sets
from snnrl.engines.fused.modulators import step_modulators
from snnrl.engines.fused.neurons import draw_noise, put_noise, sort_spikes, update_cells
from snnrl.engines.fused.plasticity import flush, pair_spikes, row_width, send, settle_projection, update_every
from snnrl.engines.fused.vectors import LANES
from snnrl.engines.layout import (
    ADDS_UP,
    MASK_AT,
    MILLISECONDS,
    PLACE,
    POST,
    PRE,
    ROW_AT,
    ROWS,
    RULE,
    SIGNAL,
    SIZE,
    START,
)


def load_trial(t, s, w, trial):
    """Lay out the state of a trial; unused places get that of a neuron beside them."""
    slots = s.pending.shape[1]
    for c in range(s.packed.shape[0]):
        n = 0
        for place in range(t.places):
            n = t.neuron_of[place] if t.neuron_of[place] >= 0 else n
            w.cells[c * t.places + place] = s.packed[c, trial, n]
    w.fed[:] = True
    w.injected[:] = 0.0
    w.still[:] = False
    for place in range(t.places):
        w.background[place] = t.background[place]
        n = t.neuron_of[place]
        if n >= 0:
            w.last[place] = w.earlier[place] = s.last_spike[trial, n]
            for slot in range(slots):
                w.pending[slot * t.places + place] = s.pending[trial, slot, n]
    each_dense(t, s, w, trial, True)


def store_trial(t, s, w, trial):
    """Put the state of a trial back where it was."""
    slots = s.pending.shape[1]
    for place in range(t.places):
        n = t.neuron_of[place]
        if n >= 0:
            s.last_spike[trial, n] = w.last[place]
            for c in range(s.packed.shape[0]):
                s.packed[c, trial, n] = w.cells[c * t.places + place]
            for slot in range(slots):
                s.pending[trial, slot, n] = w.pending[slot * t.places + place]
    each_dense(t, s, w, trial, False)


def each_dense(t, s, w, trial, loading):
    """Copy the synapses that are kept as dense rows, there or back."""
    if loading:
        w.dense[:] = 0.0
        w.masks[:] = 0
    for p in range(t.projections.shape[0]):
        at, mask = t.projections[p, ROW_AT], t.projections[p, MASK_AT]
        if at < 0:
            continue
        pre, post = t.projections[p, PRE], t.projections[p, POST]
        width, place = row_width(t.groups[post, SIZE]), t.groups[post, PLACE]
        row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE]
        for i in range(t.groups[pre, SIZE]):
            for k in range(t.rows[row + i], t.rows[row + i + 1]):
                j = t.target[k] - place
                if loading:
                    w.dense[at + j] = s.weight[k]
                    if mask >= 0:
                        w.dense[at + width + j] = s.eligibility[k]
                        w.masks[mask + j // LANES] |= 1 << (j % LANES)
                elif mask >= 0:
                    s.weight[k], s.eligibility[k] = w.dense[at + j], w.dense[at + width + j]
            at += width if mask < 0 else 3 * width
            mask += 0 if mask < 0 else width // LANES


def signal_of(t, s, trial, signal):
    """The sum of modulators that a synapse listens to."""
    level = t.signals[signal, 0] * s.level[0][trial]
    for m in range(1, t.signals.shape[1]):
        if t.signals[signal, m] != 0.0:
            level += t.signals[signal, m] * s.level[m][trial]
    return level


def learn(t, s, w, trial, now, power, found, slots):
    """Steps 4 to 7."""
    turned = False
    for signal in range(t.signals.shape[0]):
        turned |= (signal_of(t, s, trial, signal) >= 0.0) != w.positive[signal]
    if turned:
        turn(t, s, w, trial)
    farthest, inverse = 0.0, 1.0
    for signal in range(t.signals.shape[0]):
        fading = t.fading[t.signal_rule[signal], power]
        w.before[signal] = w.drive[signal]
        w.drive[signal] += fading * signal_of(t, s, trial, signal)
        farthest, inverse = max(farthest, abs(w.drive[signal])), max(inverse, 1.0 / fading)
    near = may_exceed(t, w, trial, farthest, t.headroom * inverse * found)
    if found:
        pair_spikes(t, s, w, trial, now, power, slots, not near)
        for n in range(found):
            w.earlier[w.spikes[n]] = now
    for p in range(t.projections.shape[0]):
        rule = t.projections[p, RULE]
        if rule >= 0 and not t.rules[rule, ADDS_UP]:
            signal = t.projections[p, SIGNAL]
            update_every(t, s, w, trial, p, t.fading[rule, power] * signal_of(t, s, trial, signal))
    if near and may_exceed(t, w, trial, farthest, 0.0):
        dampen(t, s, w, trial)
    if found:
        send(t, s, w, trial, now, slots, not near)


@rare
def turn(t, s, w, trial):
    """A signal has changed its sign: all weights are brought up to date before it acts."""
    flush(t, s, w, trial)
    for signal in range(t.signals.shape[0]):
        w.positive[signal] = signal_of(t, s, trial, signal) >= 0.0
    if t.set_step.shape[0]:
        measure_sets(t, s, w, trial)


def run_block(t, s, w, trial, time, steps, first, low, high, sign, raster, at, reward):
    """Up to MILLISECONDS ms of one trial that is loaded.

    Args:
        time: of the first ms.
        first: row of the injected current with which to begin.
        low, high: the blocks of neurons that the injected current drives, but for its row 0, which drives all.
        sign: of releases.
        raster: uint8 [T, b, N] to be filled with who fired, from row `at` on; or without rows.
        reward: real [T, B], from outside, from row `at` on; or without rows.
    """
    slots, blocks, learns = s.pending.shape[1], t.places // LANES, t.signals.shape[0] > 0
    shown = raster.shape[0] > 0 and trial < raster.shape[1]
    for signal in range(t.signals.shape[0]):
        w.drive[signal], w.positive[signal] = 0.0, signal_of(t, s, trial, signal) >= 0.0
    if learns and t.set_step.shape[0]:
        measure_sets(t, s, w, trial)
    skipped = draw_noise(t, w, trial, time, steps)
    for k in range(steps):
        now = time + k
        put_noise(t, w, skipped + k)
        row = first + k
        found = update_cells(t, w, now % slots, row, low if row else 0, high if row else blocks)
        if found:
            sort_spikes(t, s, w, trial, now, found)
            if shown:
                for n in range(found):
                    raster[at + k, trial, t.neuron_of[w.spikes[n]]] = 1
        step_modulators(t, s, w, trial, now, found, sign, reward[at + k, trial] if reward.shape[0] else sign * 0.0)
        if learns:
            learn(t, s, w, trial, now, k + 1, found, slots)
        elif found:
            send(t, s, w, trial, now, slots, False)
    for p in range(t.projections.shape[0]):
        if t.projections[p, RULE] >= 0:
            settle_projection(t, s, w, trial, p, t.fading[t.projections[p, RULE], steps])


def run_network(t, s, w, low, high, time, injected, sign, raster, reward):
    """Open loop: trials low to high through all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    for trial in range(low, high):
        load_trial(t, s, w, trial)
        for at in range(0, injected.shape[0], MILLISECONDS):
            steps = min(MILLISECONDS, injected.shape[0] - at)
            for k in range(steps):
                for g in range(t.groups.shape[0]):
                    size, start, place = t.groups[g, SIZE], t.groups[g, START], t.groups[g, PLACE]
                    for i in range(size):
                        w.injected[k * t.places + place + i] = injected[at + k, trial, start + i]
            run_block(t, s, w, trial, time + at, steps, 0, 0, t.places // LANES, sign[trial], raster, at, reward)
        store_trial(t, s, w, trial)
