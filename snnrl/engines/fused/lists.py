"""Projections that are kept as lists of synapses, ordered by presynaptic neuron; and rows of those that do not learn.

What learns is also found by its postsynaptic neuron (`Tables.incoming`). Weights and eligibilities are the network's
own tensors.
"""

from __future__ import annotations

import numpy as np

from snnrl.engines.fused.plasticity import feed, look_up, risen, settled_weight
from snnrl.engines.fused.vectors import LANES, load, put, store, take
from snnrl.engines.layout import (
    ADDS_UP,
    COLUMNS,
    DELAY,
    DENSE_AT,
    DEPRESSES,
    GAINS,
    GAINS_END,
    LOSSES,
    LOSSES_END,
    PLACE,
    POST,
    PRE,
    ROWS,
    RULE,
    SET,
    SIGNAL,
    SIZE,
)
from snnrl.model.homeostasis import lowered


def row_width(size):
    """A row's pairs, rounded up to whole vectors."""
    return (size + LANES - 1) // LANES * LANES


def fill_rows(t, s, w, trial):
    """Lay out the rows of projections that do not learn."""
    w.rows[:] = 0.0
    for p in t.sent:
        if t.projections[p, DENSE_AT] < 0:
            continue
        pre, post = t.projections[p, PRE], t.projections[p, POST]
        width, place = row_width(t.groups[post, SIZE]), t.groups[post, PLACE]
        row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE]
        for i in range(t.groups[pre, SIZE]):
            for k in range(t.rows[row + i], t.rows[row + i + 1]):
                w.rows[t.projections[p, DENSE_AT] + i * width + t.target[k] - place] = s.weight[k]


def synapses_of(t, p, trial):
    """Where the listed synapses of projection p of a trial begin and end."""
    size = t.groups[t.projections[p, PRE], SIZE]
    first = t.projections[p, ROWS] + trial * size
    return t.rows[first], t.rows[first + size]


def settle_list(t, s, w, trial, p, fading):
    """Bring every weight up to date; `scaled` times `fading` is what stays of the eligibility.

    Returns the sum of the weights, and of |scaled| where that makes a weight rise.
    """
    rule, signal = t.projections[p, RULE], t.projections[p, SIGNAL]
    drive, sign = w.drive[signal], 1.0 if w.positive[signal] else -1.0
    adds_up, most = t.rules[rule, ADDS_UP], t.most[rule]
    total, rise = np.float64(0.0), np.float64(0.0)
    low, high = synapses_of(t, p, trial)
    for i in range(low, high):
        scaled = s.eligibility[i]
        if adds_up:
            s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, drive - s.settled[i])
            s.settled[i] = 0.0
        s.eligibility[i] = scaled * fading
        total += s.weight[i]
        rise += max(sign * s.eligibility[i], 0.0) if s.weight[i] < most else 0.0
    return total, rise


def update_list(t, s, trial, p, change):
    """Step 5 of a projection whose rule does not add up: every weight, for one ms."""
    rule = t.projections[p, RULE]
    low, high = synapses_of(t, p, trial)
    for i in range(low, high):
        s.weight[i] = settled_weight(t, rule, s.weight[i], s.eligibility[i], change)


def lower_list(t, s, trial, p, step):
    """Lower every weight."""
    low, high = synapses_of(t, p, trial)
    for i in range(low, high):
        s.weight[i] = lowered(s.weight[i], step, t.least[t.projections[p, RULE]])


def pair_list(t, s, w, trial, now, p, power):
    """Step 4 of a projection: what this ms's spikes add to eligibilities; weights are settled first."""
    rule, pre, post, set_ = t.projections[p, RULE], t.projections[p, PRE], t.projections[p, POST], t.projections[p, SET]
    growing, positive = t.growing[rule, power], w.positive[t.projections[p, SIGNAL]]
    gains, losses, alone = t.rules[rule, GAINS], t.rules[rule, LOSSES], t.windows[t.rules[rule, GAINS]]
    depresses = t.rules[rule, DEPRESSES]
    before, after = w.first[pre + 1] - w.first[pre], w.first[post + 1] - w.first[post]
    if after:
        # the pair of spikes of one ms, if it is the only one, is made with the presynaptic one, below
        last, together = (w.earlier, alone) if depresses else (w.last, alone * 0.0)
        place = t.groups[pre, PLACE]
        look_up(t, w.rise, place, pre, last, now, gains, t.rules[rule, GAINS_END], together)
        from_before(t, s, w, trial, p, growing)
        if set_ >= 0:
            w.rising[set_] += after * growing * risen(w.rise, place, t.groups[pre, SIZE], positive)
    if before:
        together = t.windows[losses] if depresses else alone
        place = t.groups[post, PLACE]
        look_up(t, w.fall, place, post, w.last, now, losses, t.rules[rule, LOSSES_END], together)
        to_after(t, s, w, trial, p, growing)
        if set_ >= 0:
            w.rising[set_] += before * growing * risen(w.fall, place, t.groups[post, SIZE], positive)


def from_before(t, s, w, trial, p, growing):
    """The pairs of this ms's postsynaptic spikes."""
    rule, post, drive = t.projections[p, RULE], t.projections[p, POST], w.before[t.projections[p, SIGNAL]]
    column = t.projections[p, COLUMNS] + trial * t.groups[post, SIZE] - t.groups[post, PLACE]
    for n in range(w.first[post], w.first[post + 1]):
        j = column + w.spikes[n]
        for k in range(t.columns[j], t.columns[j + 1]):
            i = t.incoming[k]
            rise = w.rise[t.source[i]]
            if rise != 0.0:
                scaled = s.eligibility[i]
                if t.rules[rule, ADDS_UP]:
                    s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, drive - s.settled[i])
                    s.settled[i] = drive
                s.eligibility[i] = scaled + rise * growing


def to_after(t, s, w, trial, p, growing):
    """The pairs of this ms's presynaptic spikes."""
    rule, pre, before = t.projections[p, RULE], t.projections[p, PRE], w.before[t.projections[p, SIGNAL]]
    row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE] - t.groups[pre, PLACE]
    for n in range(w.first[pre], w.first[pre + 1]):
        j = row + w.spikes[n]
        for i in range(t.rows[j], t.rows[j + 1]):
            scaled = s.eligibility[i]
            if t.rules[rule, ADDS_UP]:
                s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, before - s.settled[i])
                s.settled[i] = before
            s.eligibility[i] = scaled + w.fall[t.target[i]] * growing


def send_list(t, s, w, trial, now, p, slots):
    """Step 7 of a projection."""
    pre, post, rule = t.projections[p, PRE], t.projections[p, POST], t.projections[p, RULE]
    if w.first[pre] == w.first[pre + 1]:
        return
    slot = (now + t.projections[p, DELAY]) % slots
    if t.projections[p, DENSE_AT] >= 0:
        send_rows(t, w, p, slot)
    else:
        learns = rule >= 0 and t.rules[rule, ADDS_UP] == 1
        drive = w.drive[t.projections[p, SIGNAL]] if learns else t.gain
        row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE] - t.groups[pre, PLACE]
        there = slot * t.places
        for n in range(w.first[pre], w.first[pre + 1]):
            j = row + w.spikes[n]
            for i in range(t.rows[j], t.rows[j + 1]):
                weight = s.weight[i]
                if learns:
                    weight = settled_weight(t, rule, weight, s.eligibility[i], drive - s.settled[i])
                    s.weight[i], s.settled[i] = weight, drive
                at = there + t.target[i]
                put(w.pending, at, take(w.pending, at) + weight * t.gain)
    feed(t, w, slot, t.groups[post, PLACE], t.groups[post, SIZE])


def send_rows(t, w, p, slot):
    """Step 7 of a projection of rows."""
    pre, post = t.projections[p, PRE], t.projections[p, POST]
    width, there = row_width(t.groups[post, SIZE]), slot * t.places + t.groups[post, PLACE]
    for n in range(w.first[pre], w.first[pre + 1]):
        at = t.projections[p, DENSE_AT] + width * (w.spikes[n] - t.groups[pre, PLACE])
        for b in range(0, width, LANES):
            store(w.pending, there + b, load(w.pending, there + b) + load(w.rows, at + b) * t.gain)
