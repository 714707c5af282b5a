"""`World.step`, `World.sense` and the coding for one trial at a time, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from snnrl.engines.fused.compiler import compiled
from snnrl.engines.fused.network import (
    BLOCK,
    SIZE,
    START,
    load,
    make_work,
    padded_width,
    raster_of,
    run_block,
    store,
)
from snnrl.engines.fused.philox import UNIT, bits, fill_bits, uniform
from snnrl.model import elementary

exp, sin, cos = (compiled(function) for function in (elementary.exp, elementary.sin, elementary.cos))
FOOD, FOOD_CONTAINER, EMPTY_CONTAINER = range(3)
OUTSIDE = -1


class WorldArrays(NamedTuple):
    """A world as arrays that share memory with its tensors."""

    position: Any
    heading: Any
    items: Any
    containers: Any
    inside: Any
    touches: Any
    home: Any
    free_items: Any
    food_containers: Any
    side: Any
    item_radius: Any
    container_radius: Any
    axle: Any
    container_speed: Any
    poison_from: Any
    reach: Any  # float64 [R]
    to_border: Any  # bool [R]
    is_food: Any  # bool [R], whether the sensor sees items or containers
    stream: Any  # of replaced free items
    held_stream: Any  # of replaced containers


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


@njit(inline="always")
def offset(origin, target, side):
    way = target - origin
    way = way - side if way >= 0.5 * side else way
    return way + side if way < -0.5 * side else way


@njit(forceinline=True)
def decode(net, coding, trial):
    """Wheel speeds from the spikes since the last call."""
    left = net.spike_count[trial, coding.motors[0]]
    right = net.spike_count[trial, coding.motors[1]]
    lead = (left - coding.decoded[trial, 0]) - (right - coding.decoded[trial, 1])
    coding.decoded[trial, 0], coding.decoded[trial, 1] = left, right
    middle, half = 0.5 * (coding.fast + coding.slow), 0.5 * (coding.fast - coding.slow)
    half *= min(max(lead, -1), 1)
    return middle + half, middle - half


@njit(forceinline=True)
def move(world, trial, left, right, seconds):
    if world.inside[trial] >= 0:
        left, right = left * world.container_speed, right * world.container_speed
    heading = world.heading[trial]
    way = 0.5 * (left + right) * seconds
    x, y = world.position[trial, 0], world.position[trial, 1]
    world.position[trial, 0] = (x + way * cos(heading)) % world.side
    world.position[trial, 1] = (y + way * sin(heading)) % world.side
    world.heading[trial] = (heading + (right - left) / world.axle * seconds) % (2.0 * math.pi)


@njit(forceinline=True)
def enter(world, trial):
    """Bring `inside` up to date; whether a container was entered."""
    x, y = world.position[trial, 0], world.position[trial, 1]
    inside = world.inside[trial]
    square = world.container_radius**2
    nearest, closest = OUTSIDE, square
    for c in range(world.containers.shape[1]):
        dx = offset(x, world.containers[trial, c, 0], world.side)
        dy = offset(y, world.containers[trial, c, 1], world.side)
        distance = dx * dx + dy * dy
        if distance < square and c == inside:
            return False
        if distance < closest:
            nearest, closest = c, distance
    world.inside[trial] = nearest
    return nearest >= 0


@njit(forceinline=True)
def take(world, seed, number, trial, time, tick_touched):
    """Take and replace the items within touch."""
    x, y = world.position[trial, 0], world.position[trial, 1]
    square, inside = world.item_radius**2, world.inside[trial]
    for m in range(world.items.shape[1]):
        if world.home[m] != inside:
            continue
        dx = offset(x, world.items[trial, m, 0], world.side)
        dy = offset(y, world.items[trial, m, 1], world.side)
        if dx * dx + dy * dy < square:
            tick_touched[FOOD] = True
            world.touches[trial, FOOD] += 1
            held = m >= world.free_items
            stream, first = (world.held_stream, 4 * (m - world.free_items)) if held else (world.stream, 4 * m)
            new_x = world.side * uniform(seed, stream, number, time, first)
            new_y = world.side * uniform(seed, stream, number, time, first + 1)
            if held:
                c = m - world.free_items
                world.containers[trial, c, 0], world.containers[trial, c, 1] = new_x, new_y
                distance = math.sqrt(uniform(seed, stream, number, time, first + 2))
                distance *= world.container_radius
                angle = 2.0 * math.pi * uniform(seed, stream, number, time, first + 3)
                new_x = (new_x + distance * cos(angle)) % world.side
                new_y = (new_y + distance * sin(angle)) % world.side
                world.inside[trial] = OUTSIDE
            world.items[trial, m, 0], world.items[trial, m, 1] = new_x, new_y


@njit(forceinline=True)
def sense(world, trial, r):
    """Which eye of range sensor r answers (0 left, 1 right), and its value."""
    x, y = world.position[trial, 0], world.position[trial, 1]
    along, across = cos(world.heading[trial]), sin(world.heading[trial])
    inside = world.inside[trial]
    objects = world.items[trial] if world.is_food[r] else world.containers[trial]
    nearest, eye = np.inf, 0
    for m in range(objects.shape[0]):
        if world.is_food[r]:
            if world.home[m] != inside:
                continue
        elif inside >= 0:
            continue
        dx, dy = offset(x, objects[m, 0], world.side), offset(y, objects[m, 1], world.side)
        distance = dx * dx + dy * dy
        if distance < nearest and dx * along + dy * across >= 0.0:
            nearest, eye = distance, 0 if dy * along - dx * across >= 0.0 else 1
    nearest = math.sqrt(nearest)
    if world.to_border[r]:
        radius = world.item_radius if world.is_food[r] else world.container_radius
        nearest = max(nearest - radius, 0.0)
    return eye, max(1.0 - nearest / world.reach[r], 0.0)


@njit(forceinline=True)
def poisson(draw, thresholds):
    count = 0
    while count < len(thresholds) and draw >= thresholds[count]:
        count += 1
    return count


@njit
def poisson_table(mean, table):
    """Cumulative probabilities as in `snnrl.model.draws.poisson_of_means`, as far as a draw can reach."""
    probability, factor = exp(-mean), 1.0
    table[:] = 1.0
    table[0] = probability
    for count in range(1, len(table)):
        factor *= mean / count
        table[count] = table[count - 1] + probability * factor
        if table[count] > 1.0 - 0.5 * UNIT:
            break


@njit
def look_up(table, draw, mean):
    """The first count whose cumulative probability exceeds the draw, sought from the mean."""
    count = int(mean)
    while table[count] <= draw:
        count += 1
    while count > 0 and table[count - 1] > draw:
        count -= 1
    return count


@njit
def fill_counts(counts, drawn, thresholds):
    """Poisson counts of many draws at once."""
    counts[:] = 0
    for threshold in thresholds:
        for n in range(len(counts)):
            counts[n] += np.int32(drawn[n] >= threshold)


@njit
def put_rows(current, counts, width, start, size):
    """Rows of `width` counts into columns start to start + size of all rows but the first."""
    for k in range(1, current.shape[0]):
        row, part = current[k, start : start + size], counts[k * width : k * width + size]
        for i in range(size):
            row[i] = part[i]


@njit
def encode(net, world, coding, trial, time, work):
    """The tick's injected current; returns the columns that its later rows have values in."""
    seed, number, real = net.seed, net.trials[trial], net.level.dtype.type
    current, drawn, counts, touched = work.current, work.drawn, work.counts, work.touched
    current[0, :] = 0.0
    for r in range(len(coding.ranges)):
        eye, value = sense(world, trial, r)
        if value > 0.0:
            group, stream = coding.ranges[r, eye], coding.range_streams[r, eye]
            poisson_table(coding.range_mean * value, work.poisson)
            for i in range(net.groups[group, SIZE]):
                draw = bits(seed, stream, number, time, i) * UNIT
                count = look_up(work.poisson, draw, coding.range_mean * value)
                current[0, net.groups[group, START] + i] += coding.range_gain * real(count)
    for kind in range(3):
        group = coding.touches[kind]
        if group >= 0 and touched[kind]:
            for i in range(net.groups[group, SIZE]):
                draw = bits(seed, coding.touch_streams[kind], number, time, i)
                count = poisson(draw, coding.touch_thresholds)
                current[0, net.groups[group, START] + i] += coding.touch_gain * real(count)
    motor = 1 if uniform(seed, coding.side_stream, number, time, 0) >= 0.5 else 0
    group = coding.motors[motor]
    size, start = net.groups[group, SIZE], net.groups[group, START]
    width = padded_width(size)
    skipped = fill_bits(drawn, width, seed, coding.exploration_streams[motor], number, time, coding.tick)
    part = slice(skipped * width, (skipped + coding.tick) * width)
    fill_counts(counts[part], drawn[part], coding.exploration_thresholds)
    for i in range(size):
        current[0, start + i] += real(counts[skipped * width + i])
    put_rows(current, counts[part], width, start, size)
    other = coding.motors[1 - motor]
    current[1:, net.groups[other, START] : net.groups[other, START] + net.groups[other, SIZE]] = 0.0
    return start, start + size


class TickWork(NamedTuple):
    """Scratch of one thread."""

    current: Any  # real [tick, N], what the tick injects
    drawn: Any
    counts: Any
    touched: Any  # bool [3], by TOUCHES
    poisson: Any


@njit
def make_tick_work(net, coding):
    widest = 0
    for motor in coding.motors:
        widest = max(widest, padded_width(net.groups[motor, SIZE]))
    return TickWork(
        np.zeros((coding.tick, net.v.shape[1]), net.v.dtype),
        np.zeros((coding.tick + 6) * widest, np.int32),
        np.zeros((coding.tick + 6) * widest, np.int32),
        np.zeros(3, np.bool_),
        np.zeros(coding.table_size),
    )


@njit
def step_world(net, world, coding, trial, time, touched):
    """`World.step`, with the wheels' decoding before it."""
    left, right = decode(net, coding, trial)
    move(world, trial, left, right, coding.tick / 1000.0)
    touched[:] = False
    if enter(world, trial):
        kind = FOOD_CONTAINER if world.inside[trial] < world.food_containers else EMPTY_CONTAINER
        touched[kind] = True
        world.touches[trial, kind] += 1
    take(world, net.seed, net.trials[trial], trial, time, touched)


@njit(nogil=True, cache=True)
def run_ticks(net, world, coding, low, high, time, ticks, raster):
    """`Simulation.tick`, `ticks` times, for trials low to high."""
    work, tick = make_work(net), make_tick_work(net, coding)
    one = net.fading[0]
    for trial in range(low, high):
        load(net, work, trial)
        shown = raster_of(raster, trial)
        for k in range(ticks):
            now = time + k * coding.tick
            step_world(net, world, coding, trial, now, tick.touched)
            first, last = encode(net, world, coding, trial, now, tick)
            sign = -one if now >= world.poison_from else one
            for at in range(0, coding.tick, BLOCK):
                spikes = shown[k * coding.tick + at : (k + 1) * coding.tick][:BLOCK]
                if at:
                    first, last = 0, net.v.shape[1]
                rows = tick.current[at : at + BLOCK]
                run_block(net, work, trial, now + at, rows, first, last, sign, spikes, None)
        store(net, work, trial)
