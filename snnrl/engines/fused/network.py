"""`Network.step` for one trial at a time, compiled and event-driven.

The results are those of `Network.step` to rounding; all tensors are up to date after every block of ms.
"""

from __future__ import annotations

from snnrl.engines.fused.compiler import rare
from snnrl.engines.fused.homeostasis import dampen, reach_with, settle
from snnrl.engines.fused.lists import fill_rows, pair_list, send_list, update_list
from snnrl.engines.fused.modulators import empty_modulators, fill_modulators, signal_of, step_modulators
from snnrl.engines.fused.neurons import draw_noise, empty_cells, fill_cells, sort_spikes, update_cells
from snnrl.engines.fused.tiles import empty_tiles, fill_tiles, pair_tiles, send_tiles, update_tiles
from snnrl.engines.fused.vectors import LANES, put, take
from snnrl.engines.layout import ADDS_UP, BY_RULE, LISTENS, PLACE, RULE, SIGNAL, SIZE, START


def load_trial(t, s, w, trial):
    """Lay out the state of a trial."""
    fill_cells(t, s, w, trial)
    fill_modulators(t, s, w, trial)
    fill_tiles(t, s, w, trial)
    fill_rows(t, s, w, trial)
    w.drive[:] = 0.0
    hear(t, w)
    settle(t, s, w, trial, 0)


def store_trial(t, s, w, trial):
    """Put the state of a trial back where it was."""
    empty_cells(t, s, w, trial)
    empty_modulators(t, s, w, trial)
    empty_tiles(t, s, w, trial)


def hear(t, w):
    """What synapses listen to now; returns whether any of it has changed its sign."""
    turned = False
    for signal in range(t.signals.shape[0]):
        level = signal_of(t, w, signal)
        w.signal[signal] = level
        turned |= (level >= 0.0) != w.positive[signal]
        w.positive[signal] = level >= 0.0
    return turned


def learn(t, s, w, trial, now, power, found, slots):
    """Steps 4 to 7."""
    if hear(t, w):
        turn(t, s, w, trial)
    farthest, growing = 0.0, 1.0
    for signal in range(t.signals.shape[0]):
        rule = t.signal_rule[signal]
        w.before[signal] = w.drive[signal]
        w.drive[signal] += t.fading[rule, power] * w.signal[signal]
        farthest, growing = max(farthest, abs(w.drive[signal])), max(growing, t.growing[rule, power])
    if found:
        through = farthest <= reach_with(t, w, trial, t.headroom * growing * found)
        pair(t, s, w, trial, now, power, through)
        w.reach[0] = reach_with(t, w, trial, 0.0)
        for n in range(found):
            w.earlier[w.spikes[n]] = now
    update_every(t, s, w, trial, power)
    if farthest > w.reach[0]:
        dampen(t, s, w, trial)
    if found:
        send(t, s, w, trial, now, slots, through)


@rare
def turn(t, s, w, trial):
    """A signal has just changed its sign: all weights are brought up to date before it acts."""
    settle(t, s, w, trial, 0)


def pair(t, s, w, trial, now, power, through):
    """Step 4."""
    for d in range(t.matrices.shape[0]):
        pair_tiles(t, w, now, d, power, through)
    for p in t.listed:
        pair_list(t, s, w, trial, now, p, power)


def update_every(t, s, w, trial, power):
    """Step 5 of rules that do not add up."""
    for d in range(t.matrices.shape[0]):
        rule = t.matrices[d, BY_RULE]
        if not t.rules[rule, ADDS_UP]:
            update_tiles(t, w, d, t.fading[rule, power] * w.signal[t.matrices[d, LISTENS]])
    for p in t.listed:
        rule = t.projections[p, RULE]
        if not t.rules[rule, ADDS_UP]:
            update_list(t, s, trial, p, t.fading[rule, power] * w.signal[t.projections[p, SIGNAL]])


def send(t, s, w, trial, now, slots, through):
    """Step 7; `through` is what `pair` was called with."""
    for d in range(t.matrices.shape[0]):
        send_tiles(t, w, now, d, slots, through or not t.rules[t.matrices[d, BY_RULE], ADDS_UP])
    for p in t.sent:
        send_list(t, s, w, trial, now, p, slots)


def run_block(t, s, w, trial, time, steps, first, low, high, sign, raster, at, reward):
    """Up to `Tables.longest` ms of one trial that is loaded.

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
    for k in range(steps if shown else 0):  # by this thread, in whose cache they are when spikes come
        raster[at + k, trial] = 0
    skipped = draw_noise(t, w, trial, time, steps)
    for k in range(steps):
        now = time + k
        row = first + k
        found = update_cells(t, w, now % slots, skipped + k, row, low if row else 0, high if row else blocks)
        if found:
            sort_spikes(t, s, w, trial, now, found)
            if shown:
                for n in range(found):
                    raster[at + k, trial, t.neuron_of[w.spikes[n]]] = 1
        step_modulators(t, w, now, found, sign, reward[at + k, trial] if reward.shape[0] else sign * 0.0)
        if learns:
            learn(t, s, w, trial, now, k + 1, found, slots)
        elif found:
            send(t, s, w, trial, now, slots, True)
    if learns:
        settle(t, s, w, trial, steps)


def run_network(t, s, w, low, high, time, injected, sign, raster, reward):
    """Open loop: trials low to high through all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    for trial in range(low, high):
        load_trial(t, s, w, trial)
        for at in range(0, injected.shape[0], t.longest):
            steps = min(t.longest, injected.shape[0] - at)
            for k in range(steps):
                row = injected[at + k, trial]
                for g in range(t.groups.shape[0]):
                    size, start, place = t.groups[g, SIZE], t.groups[g, START], k * t.places + t.groups[g, PLACE]
                    for i in range(size):
                        put(w.injected, place + i, take(row, start + i))
            run_block(t, s, w, trial, time + at, steps, 0, 0, t.places // LANES, sign[trial], raster, at, reward)
        store_trial(t, s, w, trial)
