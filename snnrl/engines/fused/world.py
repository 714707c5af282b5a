"""`World.step` and `World.sense` for one trial at a time, compiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from snnrl.body.world.geometry import FAR, drive, in_disc, offset, room_ahead, straight, within
from snnrl.body.world.kinds import ENTERED, OUTSIDE, STOPS, TAKEN, Kinds, sign_at
from snnrl.body.world.sensors import distance_to, faces, range_value
from snnrl.body.world.world import World
from snnrl.engines.fused.draws import uniform
from snnrl.model.elementary import cos, sin

PRECISION = torch.float64


class WorldArrays(NamedTuple):
    """A world as arrays that share memory with its tensors; see `World` and `Kinds`. R range sensors."""

    position: Any
    heading: Any
    places: Any
    inside: Any
    touches: Any
    unlocked: Any
    sign: Any
    absent: Any
    side: Any
    axle: Any
    seconds: Any  # of a tick
    radius: Any
    speed: Any
    room: Any
    effect: Any
    hides: Any
    signs: Any
    turns: Any
    again: Any
    leaves: Any
    returns: Any
    off_robot: Any
    apart: Any
    opens: Any
    locked: Any
    moved: Any
    counts: Any
    kind: Any
    number: Any
    holder: Any
    home: Any
    free: Any
    attempts: Any
    stops: Any  # whether anything stops the robot
    stays: Any  # whether the robot stays in the object it is in, though the centre of another be nearer
    reach: Any  # float64 [R]
    to_border: Any  # float64 [R], 1 or 0
    both: Any  # bool [R], whether both eyes answer
    sees: Any  # bool [R, K]


WORLD = WorldArrays._fields[:8]  # what a world has of its own


@lru_cache(maxsize=64)
def _described(kinds: Kinds) -> dict[str, Any]:
    """Arrays of the kinds; their sign is not the world's."""
    there = kinds.to(torch.device("cpu"))
    known = {item.name for item in fields(kinds)} & set(WorldArrays._fields) - {*WORLD, "free"}
    return {"signs": np.asarray(there.sign), **{key: np.asarray(getattr(there, key)) for key in known}}


def world_arrays(world: World, share: Callable[[Tensor], Any] = Tensor.numpy) -> WorldArrays:
    """Share memory with a world's tensors, which `share` makes arrays of."""
    kinds, config, sensors = world.kinds, world.config, list(world.config.ranges.values())
    shared = {key: share(getattr(world, key)) for key in WORLD}
    sees = [[name in world.sees[sensor] for name in kinds.names] for sensor in config.ranges]
    return WorldArrays(
        **shared,
        **_described(kinds),
        side=config.side,
        axle=config.axle,
        seconds=world.tick / 1000.0,
        free=kinds.free,
        attempts=world.attempts,
        stops=world.stops,
        stays=config.overlap == "stays",
        reach=np.array([sensor.reach for sensor in sensors]),
        to_border=np.array([float(sensor.measured_to == "border") for sensor in sensors]),
        both=np.array([sensor.answers == "both" for sensor in sensors], bool),
        sees=np.array(sees, bool).reshape(-1, len(kinds.names)),
    )


def place_of(world, trial):
    """From where the robot senses and touches."""
    inside = world.inside[trial]
    return inside if inside >= 0 and world.hides[world.kind[inside]] else OUTSIDE


def way_to(world, trial, m):
    """From the robot to the centre of an object."""
    dx = offset(world.position[trial, 0], world.places[trial, m, 0], world.side)
    return dx, offset(world.position[trial, 1], world.places[trial, m, 1], world.side)


def room_of(world, trial, way, touched):
    """How far the robot can go ahead; what stops it before it has gone its way has been touched."""
    along, across = cos(world.heading[trial]), sin(world.heading[trial])
    room, stops = FAR, OUTSIDE
    for m in range(world.kind.shape[0]):
        if world.effect[world.kind[m]] == STOPS:
            dx, dy = way_to(world, trial, m)
            free = room_ahead(dx, dy, along, across, world.radius[world.kind[m]])
            if free < room:
                room, stops = free, m
    if room < way:
        touched[world.kind[stops]] += 1
    return room


def move(world, trial, left, right, touched):
    """The robot moves, more slowly inside an object, and as far as it can."""
    inside = world.inside[trial]
    slowed = world.speed[world.kind[inside]] if inside >= 0 else 1.0
    way = straight(left * slowed, right * slowed, world.seconds)
    x, y, heading = drive(
        world.position[trial, 0],
        world.position[trial, 1],
        world.heading[trial],
        left * slowed,
        right * slowed,
        world.seconds,
        world.axle,
        world.side,
        room_of(world, trial, way, touched) if world.stops else FAR,
    )
    world.position[trial, 0], world.position[trial, 1], world.heading[trial] = x, y, heading


def enter(world, trial, touched):
    """Bring `inside` up to date; what was entered just now has been touched."""
    inside, nearest, closest = world.inside[trial], OUTSIDE, np.inf
    for m in range(world.kind.shape[0]):
        k = world.kind[m]
        if world.effect[k] != ENTERED:
            continue
        dx, dy = way_to(world, trial, m)
        squared = dx * dx + dy * dy
        if within(dx, dy, world.radius[k]):
            if m == inside and world.stays:
                return
            if squared < closest and (m == inside or world.unlocked[trial, k] or not world.locked[k]):
                nearest, closest = m, squared
    world.inside[trial] = nearest
    if nearest >= 0 and nearest != inside:
        touched[world.kind[nearest]] += 1


def take(world, seed, number, trial, time, touched):
    """Take and replace what is within touch."""
    place = place_of(world, trial)
    for m in range(world.kind.shape[0]):
        k = world.kind[m]
        if world.effect[k] != TAKEN or world.home[m] != place or world.absent[trial, k]:
            continue
        dx, dy = way_to(world, trial, m)
        if within(dx, dy, world.radius[k]):
            touched[k] += 1
            put_elsewhere(world, seed, number, trial, time, m)


def is_clear(world, trial, m, x, y):
    """Whether a place is clear of what an object's kind avoids."""
    k = world.kind[m]
    if world.off_robot[k]:
        dx = offset(x, world.position[trial, 0], world.side)
        if within(dx, offset(y, world.position[trial, 1], world.side), world.radius[k]):
            return False
    for other in range(world.free):
        if other != m and world.apart[k, world.effect[world.kind[other]]]:
            dx = offset(x, world.places[trial, other, 0], world.side)
            dy = offset(y, world.places[trial, other, 1], world.side)
            if within(dx, dy, world.radius[k] + world.radius[world.kind[other]]):
                return False
    return True


def put_elsewhere(world, seed, number, trial, time, m):
    """Move what was taken, with its holder, which is locked again; the robot is then outside of it."""
    holder = world.holder[m]
    free = holder if holder >= 0 else m
    stream, count = world.moved[world.kind[free]], world.counts[world.kind[free]]
    first, x, y = 0, 0.0, 0.0
    for attempt in range(world.attempts):
        first = 4 * (attempt * count + world.number[m])
        x = world.side * uniform(seed, stream, number, time, first)
        y = world.side * uniform(seed, stream, number, time, first + 1)
        if is_clear(world, trial, free, x, y):
            break
    world.places[trial, free, 0], world.places[trial, free, 1] = x, y
    if holder >= 0:
        room = world.room[world.kind[holder]]
        one, other = (
            uniform(seed, stream, number, time, first + 2),
            uniform(seed, stream, number, time, first + 3),
        )
        dx, dy = in_disc(room, one, other)
        world.places[trial, m, 0], world.places[trial, m, 1] = (x + dx) % world.side, (y + dy) % world.side
        world.unlocked[trial, world.kind[holder]] = False
        if world.inside[trial] == holder:
            world.inside[trial] = OUTSIDE


def step_world(world, seed, number, trial, left, right, time, touched):
    """`World.step` at these wheel speeds; how often each kind was touched, in `touched`."""
    touched[:] = 0
    move(world, trial, left, right, touched)
    enter(world, trial, touched)
    for k in range(touched.shape[0]):
        world.absent[trial, k] = world.leaves[k] <= time < world.returns[k]
    take(world, seed, number, trial, time, touched)
    sign, found = 1.0, False
    for k in range(touched.shape[0]):
        world.touches[trial, k] += touched[k]
        if touched[k]:
            sign, found = min(sign, sign_at(time, world.signs[k], world.turns[k], world.again[k])), True
            for other in range(touched.shape[0]):
                world.unlocked[trial, other] |= world.opens[k, other]
    if found:
        world.sign[trial] = sign


def sense(world, trial, r):
    """Values of the left and the right eye of range sensor r."""
    heading = world.heading[trial]
    along, across, place = cos(heading), sin(heading), place_of(world, trial)
    left, right = np.inf, np.inf
    for m in range(world.kind.shape[0]):
        k = world.kind[m]
        if not world.sees[r, k] or world.home[m] != place or world.absent[trial, k]:
            continue
        dx, dy = way_to(world, trial, m)
        inner = world.radius[k] * world.to_border[r]
        farthest = world.reach[r] + inner
        if dx * dx + dy * dy > farthest * farthest:
            continue
        ahead, leftward = faces(dx, dy, along, across)
        distance = distance_to(dx, dy, inner)
        if not ahead or distance >= (left if leftward else right):
            continue
        if world.both[r]:
            left, right = (distance, right) if leftward else (left, distance)
        elif distance < min(left, right):
            left, right = (distance, np.inf) if leftward else (np.inf, distance)
    return range_value(left, world.reach[r]), range_value(right, world.reach[r])
