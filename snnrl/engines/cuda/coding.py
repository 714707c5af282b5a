"""`Robot.begin` for one trial, compiled: its world by single threads, its currents by all."""

from __future__ import annotations

from numba import cuda, types

from snnrl.engines.cuda.compiler import WARP, barrier, real
from snnrl.engines.cuda.network import ELEMENT, after, begin, step
from snnrl.engines.cuda.plasticity import store_synapses
from snnrl.engines.cuda.poisson import poisson_of_mean
from snnrl.engines.cuda.shape import LANES, NEURONS, SLOTS
from snnrl.engines.fused.coding import decode
from snnrl.engines.fused.draws import UNIT, bits, uniform
from snnrl.engines.fused.world import sense, step_world
from snnrl.engines.layout import SIZE, START
from snnrl.model.draws import count_up


def begin_tick(t, s, w, world, coding, trial, now):
    """What takes no time, but for the currents: one thread moves the robot, then one of each warp sees for a sensor."""
    number = t.trials[trial]
    if w.lane == 0:
        left, right = decode(s.spike_count, coding, trial)
        step_world(world, t.seed, number, trial, left, right, now, w.touched)
        w.motor[0] = 1 if uniform(t.seed, coding.side_stream, number, now, 0) >= 0.5 else 0
        w.sign[0] = world.sign[trial]  # as a real number
    barrier()
    if w.lane % WARP == 0:
        r = w.lane // WARP
        while r < coding.ranges.shape[0]:
            w.seen[r, 0], w.seen[r, 1] = sense(world, trial, r)
            r += LANES // WARP
    barrier()


def inject(t, w, coding, trial, first, largest):
    """The current from outside of every neuron in a tick's first ms, in `injected`; what stays of it, in `held`."""
    n, number = w.lane, t.trials[trial]
    while n < NEURONS:
        g = t.group_of[n]
        index = n - t.groups[g, START]
        current, held = real(0.0), real(0.0)
        for r in range(coding.ranges.shape[0]):
            for eye in range(2):
                value = w.seen[r, eye]
                if coding.ranges[r, eye] == g and value > 0.0:
                    draw = bits(t.seed, coding.range_streams[r, eye], number, first, index)
                    count = poisson_of_mean(draw * UNIT, coding.range_mean * value, largest)
                    current += coding.range_gain * real(count)
                    current += real(coding.range_current * value)
                    held += real(coding.range_current * value)
        for kind in range(coding.touches.shape[0]):
            if coding.touches[kind] == g and w.touched[kind] > 0:
                draw = bits(t.seed, coding.touch_streams[kind], number, first, index)
                current += coding.touch_gain * real(poisson(draw, coding.touch_thresholds))
        w.injected[n], w.held[n] = current, held
        n += LANES


def explore(t, w, coding, trial, now, first):
    """Add what moves the robot when it sees nothing, in every ms; `first` is the tick's first.

    Pulses are over in the second ms; from then on only the neurons that explore get another current.
    """
    if now == first + 1:
        n = w.lane
        while n < NEURONS:
            w.injected[n] = w.held[n]
            n += LANES
    g, drawn = coding.motors[w.motor[0]], first if coding.held else now
    start, size = t.groups[g, START], t.groups[g, SIZE]
    index = w.lane - start % LANES  # of the first of this thread's neurons in the group
    index += LANES if index < 0 else 0
    while index < size:
        draw = bits(t.seed, coding.exploration_streams[w.motor[0]], t.trials[trial], drawn, index)
        current = w.injected[start + index] if now == first else w.held[start + index]
        count = real(poisson(draw, coding.exploration_thresholds))
        w.injected[start + index] = current + coding.exploration_gain * count
        index += LANES


def poisson(draw, thresholds):
    """One count of `snnrl.model.draws.poisson`."""
    count = 0
    for threshold in thresholds:
        count = count_up(count, draw, threshold)
    return count


def run_robot(t, s, scratch, time, world, coding, largest, ticks, raster):
    """Closed loop: `ticks` control ticks. No count of spikes of a range sensor is `largest` or more."""
    trial = cuda.blockIdx.x
    doubles = cuda.shared.array(0, types.float64)
    reals = cuda.shared.array(0, ELEMENT)
    whole = cuda.shared.array(0, types.uint32)
    w = begin(t, s, scratch, doubles, reals, whole, trial, cuda.threadIdx.x)
    slot, base = time % SLOTS, 0
    for k in range(ticks):
        first = time + k * coding.tick
        begin_tick(t.tables, s, w, world, coding, trial, first)
        inject(t.tables, w, coding, trial, first, largest)
        for row in range(coding.tick):
            explore(t.tables, w, coding, trial, first + row, first)
            base = step(t, s, w, trial, first + row, slot, base, w.sign[0], real(0.0), raster, k * coding.tick + row)
            slot = after(slot)
    store_synapses(t, s, w, trial)
