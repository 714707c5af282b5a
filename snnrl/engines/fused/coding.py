"""`Coding` for one trial at a time, compiled: wheel speeds from spikes, currents from what is sensed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from torch import Tensor

from snnrl.body.coding import Coding, lead_of, share_of, wheel_speeds
from snnrl.body.world import World
from snnrl.engines.fused.draws import fill_bits, fill_counts, replace, uniform
from snnrl.engines.fused.network import load_trial, run_block, store_trial
from snnrl.engines.fused.poisson import look_up, poisson_table
from snnrl.engines.fused.vectors import DRAWN, LANES, as_real, counting, load, load_drawn, store
from snnrl.engines.fused.world import sense, step_world
from snnrl.engines.layout import PLACE, SIZE, real_of
from snnrl.model.draws import stream
from snnrl.model.network import Network


class CodingArrays(NamedTuple):
    """A coding as arrays that share memory with its tensors. R range sensors of the world, K of its kinds."""

    decoded: Any
    shares: Any  # whether wheels go by the motors' shares of the spikes
    slow: Any
    fast: Any
    tick: Any
    motors: Any  # int64 [2], groups
    ranges: Any  # int64 [R, 2], groups
    touches: Any  # int64 [K], the group that feels each kind, -1 for none
    range_streams: Any  # int64 [R, 2]
    touch_streams: Any  # int64 [K]
    exploration_streams: Any  # int64 [2]
    side_stream: Any
    range_mean: Any
    range_gain: Any  # real
    range_current: Any
    touch_gain: Any  # real
    touch_thresholds: Any
    exploration_thresholds: Any
    exploration_gain: Any  # real
    held: Any  # whether exploration is drawn once for all ms of a tick


def coding_arrays(
    coding: Coding, network: Network, world: World, share: Callable[[Tensor], Any] = Tensor.numpy
) -> CodingArrays:
    """Share memory with a coding's tensors, which `share` makes arrays of."""
    place, config = {name: k for k, name in enumerate(network.groups)}, coding.config
    pairs = [(config.ranges[name].left, config.ranges[name].right) for name in world.config.ranges]
    touches = [config.touches.get(name) for name in world.kinds.names]
    real = real_of(network)
    return CodingArrays(
        share(coding.decoded),
        config.wheels == "share",
        config.slow,
        config.fast,
        coding.tick,
        np.array([place[name] for name in coding.motors]),
        np.array([[place[name] for name in pair] for pair in pairs], np.int64).reshape(-1, 2),
        np.array([-1 if name is None else place[name] for name in touches]),
        np.array([[stream("range", name) for name in pair] for pair in pairs], np.int64).reshape(-1, 2),
        np.array([0 if name is None else stream("touch", name) for name in touches]),
        np.array([stream("exploration", name) for name in coding.motors]),
        stream("exploring side"),
        coding.range_mean,
        real(coding.range_gain),
        config.range_current,
        real(coding.touch_gain),
        coding.touch_thresholds.cpu().numpy(),
        coding.exploration_thresholds.cpu().numpy(),
        real(config.exploration_gain),
        coding.held,
    )


def decode(spike_count, coding, trial):
    """Wheel speeds from the spikes since the last call."""
    left = spike_count[trial, coding.motors[0]]
    right = spike_count[trial, coding.motors[1]]
    new_left, new_right = left - coding.decoded[trial, 0], right - coding.decoded[trial, 1]
    lead = share_of(new_left, new_right) if coding.shares else lead_of(new_left, new_right)
    coding.decoded[trial, 0], coding.decoded[trial, 1] = left, right
    return wheel_speeds(lead, coding.slow, coding.fast)


def pulse(t, w, trial, group, stream, time, thresholds, gain):
    """A touch pulse for every neuron of a group, in the first row of the injected current."""
    fill_bits(w.drawn, t.groups[group, SIZE], t.seed, stream, t.trials[trial], time)
    for i in range(t.groups[group, SIZE]):
        count = 0
        while count < len(thresholds) and w.drawn[i] >= thresholds[count]:
            count += 1
        w.injected[t.groups[group, PLACE] + i] += gain * count


def blocks_of(t, group):
    """The blocks of neurons that a group is in, from one up to another."""
    first, size = t.groups[group, PLACE], t.groups[group, SIZE]
    return first // LANES, (first + size - 1) // LANES + 1


def clear(t, w, ticks, first, last):
    """No current but in the first row for some blocks."""
    nothing = load(w.injected, 0) * 0.0
    for k in range(1, ticks):
        for block in range(first, last):
            store(w.injected, k * t.places + block * LANES, nothing)


def explore(t, w, coding, number, group, stream, time):
    """The exploring motor's current in every ms of the tick."""
    size, place, drawn = t.groups[group, SIZE], t.groups[group, PLACE], 1 if coding.held else coding.tick
    thresholds, gain = coding.exploration_thresholds, coding.exploration_gain
    fill_counts(w.injected, place, t.places, size, t.seed, stream, number, time, drawn, thresholds, gain)
    for k in range(drawn, coding.tick):
        for i in range(place, place + size):
            w.injected[k * t.places + i] = w.injected[i]


def answer(t, w, coding, number, group, stream, time, value, table):
    """A range sensor's current: a pulse in the first row, and the same in every row."""
    mean, size, place = coding.range_mean * value, t.groups[group, SIZE], t.groups[group, PLACE]
    poisson_table(mean, table)
    fill_bits(w.drawn, size, t.seed, stream, number, time)
    for index in range(0, size, DRAWN):
        mine, here = counting(index, DRAWN) < size, place + index
        count = as_real(look_up(table, load_drawn(w.drawn, index)), w.injected)
        replace(w.injected, here, mine, load_drawn(w.injected, here) + count * coding.range_gain)
    for k in range(coding.tick if coding.range_current > 0.0 else 0):
        for i in range(k * t.places + place, k * t.places + place + size):
            w.injected[i] += coding.range_current * value


def encode(t, w, world, coding, trial, time, touched, table):
    """The tick's injected current; returns the blocks that it drives in more than the first ms."""
    number = t.trials[trial]
    w.injected[: t.places] = 0.0
    motor = 1 if uniform(t.seed, coding.side_stream, number, time, 0) >= 0.5 else 0
    group, other = coding.motors[motor], coding.motors[1 - motor]
    driven = blocks_of(t, group)
    if coding.range_current > 0.0:
        driven = 0, t.places // LANES
        clear(t, w, coding.tick, driven[0], driven[1])
    else:
        first, last = blocks_of(t, other)
        clear(t, w, coding.tick, first, last)
    explore(t, w, coding, number, group, coding.exploration_streams[motor], time)
    for r in range(len(coding.ranges)):
        left, right = sense(world, trial, r)
        for eye, value in ((0, left), (1, right)):
            if value > 0.0:
                group, stream = coding.ranges[r, eye], coding.range_streams[r, eye]
                answer(t, w, coding, number, group, stream, time, value, table)
    for kind in range(len(coding.touches)):
        group = coding.touches[kind]
        if group >= 0 and touched[kind]:
            stream = coding.touch_streams[kind]
            pulse(t, w, trial, group, stream, time, coding.touch_thresholds, coding.touch_gain)
    return driven


def run_robot(t, s, w, world, coding, table, touched, sign, low, high, time, ticks, raster, reward):
    """Closed loop: `ticks` control ticks of trials low to high.

    Scratch is `table`, for Poisson probabilities, `touched`, int64 [K], and `sign`, real [1]; `reward` is without rows.
    """
    for trial in range(low, high):
        load_trial(t, s, w, trial)
        for k in range(ticks):
            now = time + k * coding.tick
            left, right = decode(s.spike_count, coding, trial)
            step_world(world, t.seed, t.trials[trial], trial, left, right, now, touched)
            drives = encode(t, w, world, coding, trial, now, touched, table)
            sign[0] = world.sign[trial]  # as a real number
            for at in range(0, coding.tick, t.longest):
                steps = min(t.longest, coding.tick - at)
                row = k * coding.tick + at
                run_block(t, s, w, trial, now + at, steps, at, drives[0], drives[1], sign[0], raster, row, reward)
        store_trial(t, s, w, trial)
