"""`Robot.begin` for one trial, compiled: its world and wheels by one thread, its currents by all."""

from __future__ import annotations

from numba import cuda

from snnrl.engines.cuda.compiler import barrier, real
from snnrl.engines.cuda.network import ELEMENT, SHARED, begin, step
from snnrl.engines.cuda.plasticity import store_synapses
from snnrl.engines.cuda.poisson import poisson_of_mean
from snnrl.engines.fused.coding import decode
from snnrl.engines.fused.draws import UNIT, bits, uniform
from snnrl.engines.fused.world import sense, step_world
from snnrl.engines.layout import START
from snnrl.model.draws import count_up


def begin_tick(t, s, w, world, coding, trial, now):
    """What takes no time, but for the currents."""
    number = t.trials[trial]
    left, right = decode(s.spike_count, coding, trial)
    step_world(world, t.seed, number, trial, left, right, now, w.touched)
    for r in range(coding.ranges.shape[0]):
        w.seen[r, 0], w.seen[r, 1] = sense(world, trial, r)
    w.motor[0] = 1 if uniform(t.seed, coding.side_stream, number, now, 0) >= 0.5 else 0
    w.sign[0] = world.sign[trial]  # as a real number


def inject(t, w, coding, trial, now, first, largest):
    """The current from outside of every neuron in this ms, in `injected`; `first` is the tick's first ms."""
    number, explorer = t.trials[trial], coding.motors[w.motor[0]]
    for n in range(w.lane, w.injected.shape[0], w.lanes):
        g = t.group_of[n]
        index = n - t.groups[g, START]
        w.injected[n] = 0.0
        for r in range(coding.ranges.shape[0]):
            for eye in range(2):
                value = w.seen[r, eye]
                if coding.ranges[r, eye] == g and value > 0.0:
                    if now == first:
                        draw = bits(t.seed, coding.range_streams[r, eye], number, now, index)
                        count = poisson_of_mean(draw * UNIT, coding.range_mean * value, largest)
                        w.injected[n] += coding.range_gain * real(count)
                    w.injected[n] += real(coding.range_current * value)
        if now == first:
            for kind in range(coding.touches.shape[0]):
                if coding.touches[kind] == g and w.touched[kind] > 0:
                    draw = bits(t.seed, coding.touch_streams[kind], number, now, index)
                    w.injected[n] += coding.touch_gain * real(poisson(draw, coding.touch_thresholds))
        if g == explorer:
            drawn = first if coding.held else now
            draw = bits(t.seed, coding.exploration_streams[w.motor[0]], number, drawn, index)
            w.injected[n] += coding.exploration_gain * real(poisson(draw, coding.exploration_thresholds))


def poisson(draw, thresholds):
    """One count of `snnrl.model.draws.poisson`."""
    count = 0
    for threshold in thresholds:
        count = count_up(count, draw, threshold)
    return count


def run_robot(t, s, scratch, time, world, coding, largest, ticks, raster):
    """Closed loop: `ticks` control ticks. No count of spikes of a range sensor is `largest` or more."""
    trial = cuda.blockIdx.x
    memory = cuda.shared.array(0, ELEMENT) if SHARED else scratch.memory[trial]
    w = begin(t, s, scratch, memory, trial, cuda.threadIdx.x, cuda.blockDim.x)
    for k in range(ticks):
        first = time + k * coding.tick
        if w.lane == 0:
            begin_tick(t.tables, s, w, world, coding, trial, first)
        barrier()
        for row in range(coding.tick):
            inject(t.tables, w, coding, trial, first + row, first, largest)
            step(t, s, w, trial, first + row, w.sign[0], real(0.0), raster, k * coding.tick + row)
    store_synapses(t.tables, t.wiring, s, w, trial)
