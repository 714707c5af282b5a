"""`Coding` for one trial at a time, compiled: wheel speeds from spikes, currents from what is sensed."""

from __future__ import annotations

from typing import Any, NamedTuple

from snnrl.engines.fused.draws import UNIT, bits, fill_counts, uniform
from snnrl.engines.fused.network import load_trial, run_block, store_trial
from snnrl.engines.fused.poisson import look_up, poisson_table
from snnrl.engines.fused.vectors import LANES
from snnrl.engines.fused.world import sense, step_world
from snnrl.engines.layout import MILLISECONDS, PLACE, SIZE


class CodingArrays(NamedTuple):
    """A coding as arrays that share memory with its tensors."""

    decoded: Any
    slow: Any
    fast: Any
    tick: Any
    motors: Any  # int64 [2], groups
    ranges: Any  # int64 [R, 2], groups
    touches: Any  # int64 [3], group of each of TOUCHES, -1 for none
    range_streams: Any  # int64 [R, 2]
    touch_streams: Any  # int64 [3]
    exploration_streams: Any  # int64 [2]
    side_stream: Any
    range_mean: Any
    range_gain: Any  # real
    touch_gain: Any  # real
    table_size: Any  # of a Poisson table for range_mean
    touch_thresholds: Any
    exploration_thresholds: Any
    signs: Any  # real [2], of releases while items are food, and while they are poison


def decode(spike_count, coding, trial):
    """Wheel speeds from the spikes since the last call."""
    left = spike_count[trial, coding.motors[0]]
    right = spike_count[trial, coding.motors[1]]
    lead = (left - coding.decoded[trial, 0]) - (right - coding.decoded[trial, 1])
    coding.decoded[trial, 0], coding.decoded[trial, 1] = left, right
    middle, half = 0.5 * (coding.fast + coding.slow), 0.5 * (coding.fast - coding.slow)
    half *= min(max(lead, -1), 1)
    return middle + half, middle - half


def pulse(t, w, trial, group, stream, time, thresholds, gain):
    """A touch pulse for every neuron of a group, in the first row of the injected current."""
    for i in range(t.groups[group, SIZE]):
        draw = bits(t.seed, stream, t.trials[trial], time, i)
        count = 0
        while count < len(thresholds) and draw >= thresholds[count]:
            count += 1
        w.injected[t.groups[group, PLACE] + i] += gain * count


def encode(t, w, world, coding, trial, time, touched, table):
    """The tick's injected current; returns the motor that explores."""
    number = t.trials[trial]
    w.injected[: t.places] = 0.0
    motor = 1 if uniform(t.seed, coding.side_stream, number, time, 0) >= 0.5 else 0
    group, other = coding.motors[motor], coding.motors[1 - motor]
    size, place = t.groups[other, SIZE], t.groups[other, PLACE]
    for k in range(1, coding.tick):
        w.injected[k * t.places + place : k * t.places + place + size] = 0.0
    size, place, stream = t.groups[group, SIZE], t.groups[group, PLACE], coding.exploration_streams[motor]
    thresholds = coding.exploration_thresholds
    fill_counts(w.injected, place, t.places, size, t.seed, stream, number, time, coding.tick, thresholds)
    for r in range(len(coding.ranges)):
        eye, value = sense(world, trial, r)
        if value > 0.0:
            group, stream = coding.ranges[r, eye], coding.range_streams[r, eye]
            mean = coding.range_mean * value
            poisson_table(mean, table)
            for i in range(t.groups[group, SIZE]):
                draw = bits(t.seed, stream, number, time, i) * UNIT
                w.injected[t.groups[group, PLACE] + i] += coding.range_gain * look_up(table, draw, mean)
    for kind in range(len(coding.touches)):
        group = coding.touches[kind]
        if group >= 0 and touched[kind]:
            stream = coding.touch_streams[kind]
            pulse(t, w, trial, group, stream, time, coding.touch_thresholds, coding.touch_gain)
    return motor


def run_robot(t, s, w, world, coding, table, touched, low, high, time, ticks, raster, reward):
    """Closed loop: `ticks` control ticks of trials low to high; `reward` is without rows."""
    for trial in range(low, high):
        load_trial(t, s, w, trial)
        for k in range(ticks):
            now = time + k * coding.tick
            left, right = decode(s.spike_count, coding, trial)
            step_world(world, t.seed, t.trials[trial], trial, left, right, coding.tick / 1000.0, now, touched)
            motor = coding.motors[encode(t, w, world, coding, trial, now, touched, table)]
            first, size = t.groups[motor, PLACE], t.groups[motor, SIZE]
            drives = first // LANES, (first + size - 1) // LANES + 1
            sign = coding.signs[1 if now >= world.poison_from else 0]
            for at in range(0, coding.tick, MILLISECONDS):
                steps = min(MILLISECONDS, coding.tick - at)
                row = k * coding.tick + at
                run_block(t, s, w, trial, now + at, steps, at, drives[0], drives[1], sign, raster, row, reward)
        store_trial(t, s, w, trial)
