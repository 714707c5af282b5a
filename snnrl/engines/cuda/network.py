"""`Network.step`, a block of threads for each trial, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import cuda, types

from snnrl.engines.cuda.compiler import anywhere, barrier, real
from snnrl.engines.cuda.homeostasis import dampen
from snnrl.engines.cuda.neurons import update_cells
from snnrl.engines.cuda.plasticity import learn, load_synapses, send, store_synapses
from snnrl.engines.cuda.shape import GROUPS, LANES, MODULATORS, NEURONS, RUNS, SIGNALS, SLOTS, WORDS
from snnrl.engines.cuda.work import Work
from snnrl.engines.fused.modulators import note_spikes, signal_of, step_modulator


class Described(NamedTuple):
    """All that is known of a network and does not change in a run."""

    tables: Any
    wiring: Any


# what a `Program` says
SHARED: Any = None  # whether weights and eligibilities are in memory of the block, on its processor
WIDE: Any = None  # bytes of a real number
ELEMENT: Any = None  # numba's type of real numbers


def begin(t, s, scratch, doubles, reals, whole, trial, lane):
    """A thread's view of its trial, which is made ready for the first ms of a launch.

    `doubles`, `reals` and `whole` are all three all the memory of the block, on its processor.
    """
    learnt, sums = scratch.sizes
    first = 8 * sums // WIDE  # weights are behind the sums
    after = (8 * sums + 2 * learnt * WIDE if SHARED else 8 * sums) // 4
    w = Work(
        lane,
        reals[first : first + learnt] if SHARED else scratch.weight[trial],
        reals[first + learnt : first + 2 * learnt] if SHARED else scratch.eligibility[trial],
        doubles[:sums],
        whole[after : after + 2 * WORDS],
        whole[after + 2 * WORDS : after + 2 * WORDS + GROUPS],
        scratch.injected[trial],
        scratch.held[trial],
        scratch.earlier[trial],
        scratch.signal[trial],
        s.level[trial],
        s.total[trial],
        s.rate[trial],
        s.released[trial],
        scratch.touched[trial],
        scratch.seen[trial],
        scratch.motor[trial],
        scratch.sign[trial],
    )
    load_synapses(t, s, w, trial)
    clear(w.fired, 0, 2 * WORDS, lane)
    clear(w.spikes, 0, GROUPS, lane)
    barrier()
    return w


def clear(numbers, first, count, lane):
    """Make so many whole numbers 0."""
    k = lane
    while k < count:
        numbers[first + k] = 0
        k += LANES


def modulate(t, w, now, sign, reward):
    """Step 3, by one thread; it needs no spike of this ms. It also says what synapses now listen to."""
    for m in range(MODULATORS):
        step_modulator(t, w, m, now, sign, reward)
    for signal in range(SIGNALS):
        w.signal[signal] = signal_of(t, w, signal)


def note(t, s, w, trial, now, any_fired, base):
    """Tell modulators, and whoever counts spikes, of those in this ms; make room for those of the next."""
    if w.lane == LANES - 1:
        for m in range(MODULATORS):
            note_spikes(t.tables, w, m, now, any_fired)
    if any_fired:
        clear(w.fired, WORDS - base, WORDS, w.lane)
        g = w.lane
        while g < GROUPS:
            s.spike_count[trial, g] += w.spikes[g]
            g += LANES


def step(t, s, w, trial, now, slot, base, sign, reward, raster, row):
    """One ms of a trial, whose current from outside is in `injected`; the order is that of `Network.step`.

    `slot` is where in `pending` this ms is, `base` where in `fired` its spikes are; returns where the next's are.
    """
    if w.lane == LANES - 1:  # which has fewer neurons than others
        modulate(t.tables, w, now, sign, reward)
    any_fired = anywhere(update_cells(t, s, w, trial, now, slot, base, raster, row))
    note(t, s, w, trial, now, any_fired, base)
    if RUNS > 0:
        learn(t.tables, t.wiring, s, w, trial, now, any_fired, base)
    barrier()
    lowered = RUNS > 0 and dampen(t.tables, t.wiring, w, trial)
    if any_fired:
        if lowered:
            barrier()
        clear(w.spikes, 0, GROUPS, w.lane)
        send(t.tables, t.wiring, s, w, trial, slot, base)
        barrier()
        return WORDS - base
    return base


def after(slot):
    """Where in `pending` the next ms is."""
    return slot + 1 if slot + 1 < SLOTS else 0


def run_network(t, s, scratch, time, injected, sign, raster, reward):
    """Open loop: all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    trial = cuda.blockIdx.x
    doubles = cuda.shared.array(0, types.float64)
    reals = cuda.shared.array(0, ELEMENT)
    whole = cuda.shared.array(0, types.uint32)
    w = begin(t, s, scratch, doubles, reals, whole, trial, cuda.threadIdx.x)
    slot, base = time % SLOTS, 0
    for k in range(injected.shape[0]):
        n = w.lane
        while n < NEURONS:
            w.injected[n] = injected[k, trial, n]
            n += LANES
        given = reward[k, trial] if reward.shape[0] > 0 else real(0.0)
        base = step(t, s, w, trial, time + k, slot, base, sign[trial], given, raster, k)
        slot = after(slot)
    store_synapses(t, s, w, trial)
