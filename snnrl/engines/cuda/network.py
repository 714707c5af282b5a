"""`Network.step`, a block of threads for each trial, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import cuda

from snnrl.engines.cuda.compiler import barrier, real
from snnrl.engines.cuda.homeostasis import dampen
from snnrl.engines.cuda.neurons import count_spikes, update_cells
from snnrl.engines.cuda.plasticity import learn, load_synapses, send, store_synapses
from snnrl.engines.cuda.work import Work
from snnrl.engines.fused.modulators import signal_of, step_modulators


class Described(NamedTuple):
    """All that is known of a network and does not change in a run."""

    tables: Any
    wiring: Any


# what a `Program` says
SHARED: Any = None  # whether weights and eligibilities are in memory of the block, on its processor
ELEMENT: Any = None  # numba's type of real numbers


def begin(t, s, scratch, memory, trial, lane, lanes):
    """A thread's view of its trial, which is made ready for the first ms of a launch."""
    w = Work(
        lane,
        lanes,
        memory,
        scratch.injected[trial],
        scratch.fired[trial],
        scratch.earlier[trial],
        scratch.first[trial],
        scratch.latest[trial],
        scratch.signal[trial],
        scratch.partial[trial],
        s.level[trial],
        s.total[trial],
        s.rate[trial],
        s.released[trial],
        scratch.touched[trial],
        scratch.seen[trial],
        scratch.motor[trial],
        scratch.sign[trial],
    )
    load_synapses(t.tables, t.wiring, s, w, trial)
    if lane == 0:
        w.latest[0] = -1
        w.first[0] = 0
    barrier()
    return w


def modulate(t, w, now, any_fired, sign, reward):
    """Step 3, by one thread: it also says what synapses now listen to."""
    for g in range(t.groups.shape[0]):
        w.first[g + 1] = w.first[g] + w.first[g + 1] if any_fired else 0
    step_modulators(t, w, now, 1 if any_fired else 0, sign, reward)
    for signal in range(t.signals.shape[0]):
        w.signal[signal] = signal_of(t, w, signal)


def step(t, s, w, trial, now, sign, reward, raster, row):
    """One ms of a trial, whose current from outside is in `injected`; the order is that of `Network.step`."""
    update_cells(t, s, w, trial, now, raster, row)
    barrier()
    any_fired = w.latest[0] == now
    if any_fired:
        count_spikes(t, s, w, trial)
        barrier()
    if w.lane == 0:
        modulate(t.tables, w, now, any_fired, sign, reward)
    barrier()
    if t.tables.signals.shape[0] > 0:
        learn(t.tables, t.wiring, s, w, trial, now, any_fired)
        dampen(t.tables, t.wiring, w, trial)
    if any_fired:
        barrier()
        send(t.tables, t.wiring, s, w, trial, now)
    barrier()


def run_network(t, s, scratch, time, injected, sign, raster, reward):
    """Open loop: all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    trial = cuda.blockIdx.x
    memory = cuda.shared.array(0, ELEMENT) if SHARED else scratch.memory[trial]
    w = begin(t, s, scratch, memory, trial, cuda.threadIdx.x, cuda.blockDim.x)
    for k in range(injected.shape[0]):
        for n in range(w.lane, injected.shape[2], w.lanes):
            w.injected[n] = injected[k, trial, n]
        given = reward[k, trial] if reward.shape[0] > 0 else real(0.0)
        step(t, s, w, trial, time + k, sign[trial], given, raster, k)
    store_synapses(t.tables, t.wiring, s, w, trial)
