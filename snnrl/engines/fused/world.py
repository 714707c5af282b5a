"""`World.step` and `World.sense` for one trial at a time, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from snnrl.engines.fused.draws import uniform
from snnrl.model.elementary import cos, sin

PRECISION = torch.float64
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


def offset(origin, target, side):
    way = target - origin
    way = way - side if way >= 0.5 * side else way
    return way + side if way < -0.5 * side else way


def move(world, trial, left, right, seconds):
    if world.inside[trial] >= 0:
        left, right = left * world.container_speed, right * world.container_speed
    heading = world.heading[trial]
    way = 0.5 * (left + right) * seconds
    x, y = world.position[trial, 0], world.position[trial, 1]
    world.position[trial, 0] = (x + way * cos(heading)) % world.side
    world.position[trial, 1] = (y + way * sin(heading)) % world.side
    world.heading[trial] = (heading + (right - left) / world.axle * seconds) % (2.0 * math.pi)


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


def step_world(world, seed, number, trial, left, right, seconds, time, touched):
    """`World.step` at these wheel speeds; what was touched, in `touched`."""
    move(world, trial, left, right, seconds)
    touched[:] = False
    if enter(world, trial):
        kind = FOOD_CONTAINER if world.inside[trial] < world.food_containers else EMPTY_CONTAINER
        touched[kind] = True
        world.touches[trial, kind] += 1
    take(world, seed, number, trial, time, touched)
