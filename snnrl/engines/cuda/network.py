"""`Network.step`, a block of threads for each trial, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import cuda, types

from snnrl.engines.cuda.compiler import anywhere, barrier, real
from snnrl.engines.cuda.homeostasis import dampen
from snnrl.engines.cuda.neurons import update_cells
from snnrl.engines.cuda.plasticity import learn, load_synapses, send, store_synapses
from snnrl.engines.cuda.work import Work
from snnrl.engines.fused.modulators import signal_of, step_modulators


class Described(NamedTuple):
    """All that is known of a network and does not change in a run."""

    tables: Any
    wiring: Any


# what a `Program` says
SHARED: Any = None  # whether weights and eligibilities are in memory of the block, on its processor
WIDE: Any = None  # bytes of a real number
ELEMENT: Any = None  # numba's type of real numbers


def begin(t, s, scratch, doubles, reals, trial, lane, lanes):
    """A thread's view of its trial, which is made ready for the first ms of a launch.

    `doubles` and `reals` are both all the memory of the block, on its processor.
    """
    learnt, sums = scratch.sizes
    first = 2 * sums if WIDE == 4 else sums  # weights are behind the sums, as real numbers
    w = Work(
        lane,
        lanes,
        reals[first : first + learnt] if SHARED else scratch.weight[trial],
        reals[first + learnt : first + 2 * learnt] if SHARED else scratch.eligibility[trial],
        doubles[:sums] if SHARED else scratch.partial[trial],
        scratch.injected[trial],
        scratch.held[trial],
        scratch.fired[trial],
        scratch.earlier[trial],
        scratch.spikes[trial],
        scratch.over[trial],
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
    clear_spikes(w)
    barrier()
    return w


def clear_spikes(w):
    """No group has fired."""
    g = w.lane
    while g < w.spikes.shape[0]:
        w.spikes[g] = 0
        g += w.lanes


def modulate(t, w, now, any_fired, sign, reward):
    """Step 3, by one thread: it also says what synapses now listen to."""
    step_modulators(t, w, now, 1 if any_fired else 0, sign, reward)
    for signal in range(t.signals.shape[0]):
        w.signal[signal] = signal_of(t, w, signal)


def step(t, s, w, trial, now, slot, sign, reward, raster, row):
    """One ms of a trial, whose current from outside is in `injected`; the order is that of `Network.step`.

    `slot` is where in `pending` this ms is.
    """
    some, senders = update_cells(t, s, w, trial, now, slot, raster, row)
    any_fired = anywhere(some)
    if w.lane == 0:
        modulate(t.tables, w, now, any_fired, sign, reward)
    any_sends = anywhere(senders)
    if any_fired:
        clear_spikes(w)
    if t.wiring.runs.shape[0] > 0:
        learn(t.tables, t.wiring, s, w, trial, now, any_fired)
        dampen(t.tables, t.wiring, w, trial)
    if any_sends:
        barrier()
        send(t.tables, t.wiring, s, w, trial, slot)
    barrier()


def after(slot, slots):
    """Where in `pending` the next ms is."""
    return slot + 1 if slot + 1 < slots else 0


def run_network(t, s, scratch, time, injected, sign, raster, reward):
    """Open loop: all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    trial, slots = cuda.blockIdx.x, s.pending.shape[1]
    doubles = cuda.shared.array(0, types.float64)
    reals = cuda.shared.array(0, ELEMENT)
    w = begin(t, s, scratch, doubles, reals, trial, cuda.threadIdx.x, cuda.blockDim.x)
    slot = time % slots
    for k in range(injected.shape[0]):
        n = w.lane
        while n < injected.shape[2]:
            w.injected[n] = injected[k, trial, n]
            n += w.lanes
        given = reward[k, trial] if reward.shape[0] > 0 else real(0.0)
        step(t, s, w, trial, time + k, slot, sign[trial], given, raster, k)
        slot = after(slot, slots)
    store_synapses(t, s, w, trial)
