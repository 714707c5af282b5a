"""The books of `snnrl.beyond.account`, kept ms by ms: compiled, LANES synapses at a time and then what is left."""

from __future__ import annotations

from typing import Any, NamedTuple

from snnrl.engines.fused.vectors import LANES, across, load, store
from snnrl.model.homeostasis import lowered
from snnrl.model.modulators import burst, relax
from snnrl.model.plasticity import hard_bounds

SOURCES = ("food", "container", "no touch")  # of releases
FROM_FOOD, FROM_CONTAINER, FROM_NOTHING = range(3)
PARTS = (*SOURCES, "hunger", "clipped", "dampened", "rounding")
HUNGER, CLIPPED, DAMPENED, ROUNDING = range(3, 7)


class Books(NamedTuple):
    """The learning of B trials in float64: S plastic synapses of P projections, in the order of the network's table.

    `parts`, [B, P, 7], is the sum over synapses of each of PARTS, mV. `level`, [B, 3], is what is left of each source's
    releases, uM; `counts` and `causes`, [B, delay], are rings of the spikes on the way and of their sources.
    """

    parts: Any
    weight: Any
    eligibility: Any
    pre: Any  # int64 [S], neurons, counted within the trial
    post: Any
    first: Any  # int64 [P, B + 1], where the synapses of each trial begin
    from_pre: Any  # int64 [S], synapses in the order of their presynaptic neurons
    from_post: Any
    pre_first: Any  # int64 [B, N + 1], where those of each neuron begin
    post_first: Any
    last: Any  # int64 [B, N], ms of the last spike
    total: Any  # float64 [P], sum of a trial's weights
    level: Any
    counts: Any
    causes: Any
    released_by: Any  # int64 [2], the first dopaminergic neuron, and the one after the last
    baseline: Any
    fading: Any  # of the level in a ms
    release: Any
    threshold: Any
    gains: Any
    losses: Any
    decay: Any
    least: Any
    most: Any
    sets: Any  # bool [K, P], the projections of each homeostatic set
    limit: Any  # float64 [K, B], of the sum of its weights
    step: Any  # float64 [K]


def book(b, time, fired, causes, signs, exact):
    """A tick of all trials: who fired, bool [tick, B, N], and at its end the run's own weights, float64 [S]."""
    for trial in range(b.last.shape[0]):
        for row in range(fired.shape[0]):
            now = time + row
            signal = listen(b, trial, now, fired[row, trial], causes[trial], signs[trial])
            remember(b, trial, now, fired[row, trial])
            change(b, trial, signal)
            dampen(b, trial)
        for p in range(b.first.shape[0]):
            for s in range(b.first[p, trial], b.first[p, trial + 1]):
                b.parts[trial, p, ROUNDING] += exact[s] - b.weight[s]
                b.weight[s] = exact[s]


def listen(b, trial, now, fired, cause, sign):
    """Step 3 of `Network.step`, each source's part of dopamine by itself; the whole level."""
    slot, spikes = now % b.counts.shape[1], 0
    for n in range(b.released_by[0], b.released_by[1]):
        spikes += fired[n]
    released = sign * burst(b.counts[trial, slot], b.release, b.threshold)
    signal = b.baseline
    for source in range(b.level.shape[1]):
        level = relax(b.level[trial, source], 0.0, b.fading)
        if source == b.causes[trial, slot]:
            level += released
        b.level[trial, source] = level
        signal += level
    b.counts[trial, slot], b.causes[trial, slot] = spikes, cause
    return signal


def remember(b, trial, now, fired):
    """Step 4 of `Network.step`."""
    for p in range(b.first.shape[0]):
        for s in range(b.first[p, trial], b.first[p, trial + 1]):
            b.eligibility[s] *= b.decay
    for n in range(fired.shape[0]):
        if fired[n]:
            for k in range(b.post_first[trial, n], b.post_first[trial, n + 1]):
                s = b.from_post[k]
                b.eligibility[s] += b.gains[min(now - b.last[trial, b.pre[s]], b.gains.shape[0] - 1)]
    for n in range(fired.shape[0]):
        if fired[n]:
            b.last[trial, n] = now
    for n in range(fired.shape[0]):
        if fired[n]:
            for k in range(b.pre_first[trial, n], b.pre_first[trial, n + 1]):
                s = b.from_pre[k]
                b.eligibility[s] += b.losses[min(now - b.last[trial, b.post[s]], b.losses.shape[0] - 1)]


def change(b, trial, signal):
    """Step 5 of `Network.step`, and what of it is whose; LANES synapses at a time, then those that are left."""
    for p in range(b.first.shape[0]):
        s, end = b.first[p, trial], b.first[p, trial + 1]
        eligible, clipped, total = 0.0, 0.0, 0.0
        if s + LANES <= end:
            nothing = load(b.weight, s) * 0.0
            eligibles, clips, totals = nothing, nothing, nothing
            while s + LANES <= end:
                eligibility, weight = load(b.eligibility, s), load(b.weight, s)
                driven = eligibility * signal
                bounded = hard_bounds(weight, driven, b.least, b.most)
                store(b.weight, s, bounded)
                eligibles, totals = eligibles + eligibility, totals + bounded
                clips = clips + (bounded - (weight + driven))
                s += LANES
            eligible, clipped, total = across(eligibles), across(clips), across(totals)
        while s < end:
            driven = b.eligibility[s] * signal
            free = b.weight[s] + driven
            b.weight[s] = hard_bounds(b.weight[s], driven, b.least, b.most)
            eligible += b.eligibility[s]
            clipped += b.weight[s] - free
            total += b.weight[s]
            s += 1
        for source in range(b.level.shape[1]):
            b.parts[trial, p, source] += b.level[trial, source] * eligible
        b.parts[trial, p, HUNGER] += b.baseline * eligible
        b.parts[trial, p, CLIPPED] += clipped
        b.total[p] = total


def dampen(b, trial):
    """Step 6 of `Network.step`."""
    for k in range(b.sets.shape[0]):
        total = 0.0
        for p in range(b.first.shape[0]):
            if b.sets[k, p]:
                total += b.total[p]
        for p in range(b.first.shape[0] if total > b.limit[k, trial] else 0):
            for s in range(b.first[p, trial], b.first[p, trial + 1] if b.sets[k, p] else b.first[p, trial]):
                less = lowered(b.weight[s], b.step[k], b.least)
                b.parts[trial, p, DAMPENED] += less - b.weight[s]
                b.weight[s] = less
