"""Steps 4, 5 and 7 of `Network.step`: synapses, only where a spike passes.

Most synapses see no spike in most milliseconds, so eligibility and weight are brought up to date only when they are
needed. Within a block of milliseconds, with lambda = exp(-1 / tau_eligibility):

- A synapse keeps `scaled` = eligibility / lambda^k at the k-th ms of the block, which only spikes change.
- For each signal, the sum of modulators that a synapse listens to, the trial keeps `drive`, the sum of lambda^k times
  the signal since the last flush. A weight that was settled when that was `settled` is now, by an additive weight rule
  (`snnrl.model.plasticity.additive`), that of a single change of scaled * (drive - settled).
- So it is as long as neither eligibility changes (then the synapse is settled first) nor the signal its sign (then all
  synapses that listen to it are: a flush).

Synapses whose rule is not additive are all updated in every ms. Projections with many synapses are kept as dense rows
of all pairs of a presynaptic neuron, LANES targets at a time; a row holds weight, scaled and settled side by side, and
where there is no synapse all of them stay 0. Others are lists; how a projection is kept changes no bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.fused.vectors import LANES, bits_mask, load, select, store
from snnrl.engines.layout import (
    ADDS_UP,
    BOUNDS,
    COLUMNS,
    DELAY,
    DEPRESSES,
    GAINS,
    GAINS_END,
    LOSSES,
    LOSSES_END,
    MASK_AT,
    PLACE,
    POST,
    PRE,
    ROW_AT,
    ROWS,
    RULE,
    SET,
    SIGNAL,
    SIZE,
    WEIGHT_RULE,
    Functions,
)


@placeholder
def bound(which, weight, change, values, at):
    """A weight after a change, by one of the weight rules, with further arguments from `at` on."""


def row_width(size):
    """A dense row's pairs, rounded up to whole vectors."""
    return (size + LANES - 1) // LANES * LANES


def synapses_of(t, p, trial):
    """Where the listed synapses of projection p of a trial begin and end."""
    size = t.groups[t.projections[p, PRE], SIZE]
    first = t.projections[p, ROWS] + trial * size
    return t.rows[first], t.rows[first + size]


def settled_weight(t, rule, weight, scaled, change):
    """A weight that `scaled` times a drive has acted on."""
    return bound(t.rules[rule, WEIGHT_RULE], weight, scaled * change, t.bounds, t.rules[rule, BOUNDS])


def settle_projection(t, s, w, trial, p, fading):
    """Bring every weight of projection p up to date; `scaled` times `fading` is what stays of the eligibility."""
    rule, drive = t.projections[p, RULE], w.drive[t.projections[p, SIGNAL]]
    adds_up = t.rules[rule, ADDS_UP]
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(t.groups[t.projections[p, POST], SIZE])
        at, mask = t.projections[p, ROW_AT], t.projections[p, MASK_AT]
        for _ in range(t.groups[t.projections[p, PRE], SIZE]):
            for b in range(0, width, LANES):
                scaled = load(w.dense, at + width + b)
                if adds_up:
                    change = drive - load(w.dense, at + 2 * width + b)
                    weight = settled_weight(t, rule, load(w.dense, at + b), scaled, change)
                    store(w.dense, at + b, select(bits_mask(w.masks[mask]), weight, weight * 0.0))
                    store(w.dense, at + 2 * width + b, scaled * 0.0)
                store(w.dense, at + width + b, scaled * fading)
                mask += 1
            at += 3 * width
    else:
        low, high = synapses_of(t, p, trial)
        for i in range(low, high):
            scaled = s.eligibility[i]
            if adds_up:
                s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, drive - s.settled[i])
                s.settled[i] = 0.0
            s.eligibility[i] = scaled * fading


def flush(t, s, w, trial):
    """Bring every weight up to date; the drives start at zero again."""
    for p in range(t.projections.shape[0]):
        if t.projections[p, RULE] >= 0 and t.rules[t.projections[p, RULE], ADDS_UP]:
            settle_projection(t, s, w, trial, p, t.fading[0, 0])
    w.drive[:] = 0.0


def update_every(t, s, w, trial, p, change):
    """Step 5 of a projection whose rule does not add up: every weight, for one ms."""
    rule = t.projections[p, RULE]
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(t.groups[t.projections[p, POST], SIZE])
        at, masks = t.projections[p, ROW_AT], t.projections[p, MASK_AT]
        for _ in range(t.groups[t.projections[p, PRE], SIZE]):
            for b in range(0, width, LANES):
                weight = load(w.dense, at + b)
                after = settled_weight(t, rule, weight, load(w.dense, at + width + b), change)
                store(w.dense, at + b, select(bits_mask(w.masks[masks]), after, weight))
                masks += 1
            at += 3 * width
    else:
        low, high = synapses_of(t, p, trial)
        for i in range(low, high):
            s.weight[i] = settled_weight(t, rule, s.weight[i], s.eligibility[i], change)


def look_up(t, w, out, group, last, now, first, end, together):
    """What a spike adds for each neuron of a group, by the ms since its last spike, into `out`.

    `together` is what it adds where that is none. Returns the sum of what raises and of what lowers.
    """
    up, down = 0.0, 0.0
    place = t.groups[group, PLACE]
    for n in range(place, place + t.groups[group, SIZE]):
        elapsed = now - last[n]
        added = t.windows[first + min(elapsed, end - 1 - first)] if elapsed > 0 else together
        out[n] = added
        up += max(added, 0.0)
        down -= min(added, 0.0)
    return up, down


def pair_spikes(t, s, w, trial, now, power, slots, sending):
    """Step 4: what this ms's spikes add to eligibilities; weights are settled first.

    Where `sending` allows it, step 7 of dense rows that learn by additive rules is done in the same pass; then
    nothing between the two may change a weight.
    """
    for p in range(t.projections.shape[0]):
        rule = t.projections[p, RULE]
        if rule < 0:
            continue
        pre, post = t.projections[p, PRE], t.projections[p, POST]
        before, after = w.first[pre + 1] - w.first[pre], w.first[post + 1] - w.first[post]
        if before == 0 and after == 0:
            continue
        inverse = 1.0 / t.fading[rule, power]
        positive, set_ = w.positive[t.projections[p, SIGNAL]], t.projections[p, SET]
        gains, losses = t.rules[rule, GAINS], t.rules[rule, LOSSES]
        alone = t.windows[gains]
        if after:
            if t.rules[rule, DEPRESSES]:
                up, down = look_up(t, w, w.rise, pre, w.earlier, now, gains, t.rules[rule, GAINS_END], alone)
            else:  # the pair of spikes of one ms is made with the presynaptic one, below
                up, down = look_up(t, w, w.rise, pre, w.last, now, gains, t.rules[rule, GAINS_END], alone * 0.0)
            pair_columns(t, s, w, trial, p, inverse)
            if set_ >= 0:
                w.rising[set_] += after * inverse * (up if positive else down)
        if before:
            together = t.windows[losses] if t.rules[rule, DEPRESSES] else alone
            up, down = look_up(t, w, w.fall, post, w.last, now, losses, t.rules[rule, LOSSES_END], together)
            pair_rows(t, s, w, trial, now, p, inverse, slots, sending)
            if set_ >= 0:
                w.rising[set_] += before * inverse * (up if positive else down)


def pair_columns(t, s, w, trial, p, inverse):
    """The pairs of this ms's postsynaptic spikes."""
    rule, signal = t.projections[p, RULE], t.projections[p, SIGNAL]
    pre, post = t.projections[p, PRE], t.projections[p, POST]
    drive, adds_up = w.before[signal], t.rules[rule, ADDS_UP]
    size, first, place = t.groups[pre, SIZE], t.groups[pre, PLACE], t.groups[post, PLACE]
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(t.groups[post, SIZE])
        for n in range(w.first[post], w.first[post + 1]):
            j = w.spikes[n] - place
            at, mask = t.projections[p, ROW_AT] + j, t.projections[p, MASK_AT] + j // LANES
            bit = 1 << (j % LANES)
            for i in range(first, first + size):
                if w.rise[i] != 0.0 and w.masks[mask] & bit:
                    scaled = w.dense[at + width]
                    if adds_up:
                        change = drive - w.dense[at + 2 * width]
                        w.dense[at] = settled_weight(t, rule, w.dense[at], scaled, change)
                        w.dense[at + 2 * width] = drive
                    w.dense[at + width] = scaled + w.rise[i] * inverse
                at += 3 * width
                mask += width // LANES
    else:
        column = t.projections[p, COLUMNS] + trial * t.groups[post, SIZE] - place
        for n in range(w.first[post], w.first[post + 1]):
            j = column + w.spikes[n]
            for k in range(t.columns[j], t.columns[j + 1]):
                i = t.incoming[k]
                rise = w.rise[t.source[i]]
                if rise != 0.0:
                    scaled = s.eligibility[i]
                    if adds_up:
                        s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, drive - s.settled[i])
                        s.settled[i] = drive
                    s.eligibility[i] = scaled + rise * inverse


def pair_rows(t, s, w, trial, now, p, inverse, slots, sending):
    """The pairs of this ms's presynaptic spikes, which also leave where `sending` allows it."""
    rule, signal = t.projections[p, RULE], t.projections[p, SIGNAL]
    pre, post = t.projections[p, PRE], t.projections[p, POST]
    before, drive, adds_up = w.before[signal], w.drive[signal], t.rules[rule, ADDS_UP]
    first, place, size = t.groups[pre, PLACE], t.groups[post, PLACE], t.groups[post, SIZE]
    if t.projections[p, ROW_AT] >= 0:
        width = row_width(size)
        leaves = sending and adds_up
        slot = (now + t.projections[p, DELAY]) % slots
        there = slot * t.places + place
        for n in range(w.first[pre], w.first[pre + 1]):
            i = w.spikes[n] - first
            at, mask = t.projections[p, ROW_AT] + 3 * width * i, t.projections[p, MASK_AT] + width // LANES * i
            for b in range(0, width, LANES):
                scaled = load(w.dense, at + width + b)
                added = scaled + load(w.fall, place + b) * inverse
                there_is = bits_mask(w.masks[mask])
                eligible = select(there_is, added, scaled)
                mask += 1
                store(w.dense, at + width + b, eligible)
                if adds_up:
                    settled = load(w.dense, at + 2 * width + b)
                    weight = settled_weight(t, rule, load(w.dense, at + b), scaled, before - settled)
                    weight = settled_weight(t, rule, weight, eligible, drive - before)
                    weight = select(there_is, weight, weight * 0.0)
                    store(w.dense, at + b, weight)
                    store(w.dense, at + 2 * width + b, settled * 0.0 + drive)
                    if leaves:
                        store(w.pending, there + b, load(w.pending, there + b) + weight * t.gain)
            at += 3 * width
        if leaves:
            feed(t, w, slot, place, size)
    else:
        row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE] - first
        for n in range(w.first[pre], w.first[pre + 1]):
            j = row + w.spikes[n]
            for i in range(t.rows[j], t.rows[j + 1]):
                scaled = s.eligibility[i]
                if adds_up:
                    s.weight[i] = settled_weight(t, rule, s.weight[i], scaled, before - s.settled[i])
                    s.settled[i] = before
                s.eligibility[i] = scaled + w.fall[t.target[i]] * inverse


def feed(t, w, slot, place, size):
    """Note that something is pending for some neurons."""
    blocks = t.places // LANES
    for b in range(place // LANES, (place + size - 1) // LANES + 1):
        w.fed[slot * blocks + b] = True


def send(t, s, w, trial, now, slots, paired):
    """Step 7: this ms's spikes leave; `paired` says that `pair_spikes` has sent those of dense rows that learn."""
    for p in range(t.projections.shape[0]):
        pre, post, rule = t.projections[p, PRE], t.projections[p, POST], t.projections[p, RULE]
        if w.first[pre] == w.first[pre + 1]:
            continue
        dense = t.projections[p, ROW_AT] >= 0
        adds_up = rule >= 0 and t.rules[rule, ADDS_UP] == 1
        if dense and adds_up and paired:
            continue
        slot = (now + t.projections[p, DELAY]) % slots
        first, place, size = t.groups[pre, PLACE], t.groups[post, PLACE], t.groups[post, SIZE]
        drive = w.drive[t.projections[p, SIGNAL]] if adds_up else t.gain
        if dense:
            width = row_width(size)
            parts = 1 if t.projections[p, MASK_AT] < 0 else 3
            there = slot * t.places + place
            for n in range(w.first[pre], w.first[pre + 1]):
                i = w.spikes[n] - first
                at, mask = t.projections[p, ROW_AT] + parts * width * i, t.projections[p, MASK_AT] + width // LANES * i
                for b in range(0, width, LANES):
                    weight = load(w.dense, at + b)
                    if adds_up:
                        change = drive - load(w.dense, at + 2 * width + b)
                        weight = settled_weight(t, rule, weight, load(w.dense, at + width + b), change)
                        weight = select(bits_mask(w.masks[mask]), weight, weight * 0.0)
                        mask += 1
                    store(w.pending, there + b, load(w.pending, there + b) + weight * t.gain)
        else:
            row = t.projections[p, ROWS] + trial * t.groups[pre, SIZE] - first
            there = slot * t.places
            for n in range(w.first[pre], w.first[pre + 1]):
                j = row + w.spikes[n]
                for i in range(t.rows[j], t.rows[j + 1]):
                    weight = s.weight[i]
                    if adds_up:
                        weight = settled_weight(t, rule, weight, s.eligibility[i], drive - s.settled[i])
                        s.weight[i], s.settled[i] = weight, drive
                    w.pending[there + t.target[i]] += weight * t.gain
        feed(t, w, slot, place, size)


def bounding(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `bound` and the names in it stand for in a network of those weight rules."""
    lines, names = [], {}
    for k, (function, count) in enumerate(functions.weight_rules):
        names[f"rule_{k}"] = function
        given = "".join(f", values[at + {i}]" for i in range(count))
        lines += [f"    if which == {k}:", f"        return rule_{k}(weight, change{given})"]
    if lines:
        lines[-2] = "    if True:"  # the last needs no question
    body = "\n".join(lines or ["    return weight"])
    return {"bound": spelled("bound", "which, weight, change, values, at", body, {}), **names}
