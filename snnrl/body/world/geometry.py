"""Positions on a square torus (cm) and the two-wheeled robot's motion; pure elementwise functions of numbers."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from snnrl.model.elementary import cos, sin, square_root

PRECISION = torch.float64
TURN = 2.0 * math.pi
FAR = math.inf  # cm


def offset(origin: Tensor, target: Tensor, side: float) -> Tensor:
    """Shortest way from origin to target along one axis, both in [0, side]; in [-side/2, side/2)."""
    way = target - origin
    way = torch.where(way >= 0.5 * side, way - side, way)
    return torch.where(way < -0.5 * side, way + side, way)


def straight(left: Tensor, right: Tensor, seconds: float) -> Tensor:
    """How far a robot goes along its heading in a step (cm); arguments as for `drive`."""
    return 0.5 * (left + right) * seconds


def room_ahead(dx: Tensor, dy: Tensor, along: Tensor, across: Tensor, radius: Tensor) -> Tensor:
    """How far one may go straight ahead to the edge of a disc (cm), 0 at or inside of it; infinite if it is not hit.

    Args:
        dx, dy: the way to the disc's centre, cm.
        along, across: cosine and sine of the heading.
        radius: cm.
    """
    ahead, aside = dx * along + dy * across, dy * along - dx * across
    squared = radius * radius - aside * aside
    hit = (ahead > 0.0) & (squared > 0.0)
    room = ahead - square_root(torch.where(hit, squared, 0.0))
    return torch.where(hit, torch.where(room > 0.0, room, 0.0), FAR)


def drive(
    x: Tensor,
    y: Tensor,
    heading: Tensor,
    left: Tensor,
    right: Tensor,
    seconds: float,
    axle: float,
    side: float,
    room: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """One Euler step of a two-wheeled robot: first along the old heading, then the turn.

    Args:
        x, y: cm. heading: rad, anticlockwise from the x axis.
        left, right: speed of the wheels, cm/s.
        seconds: the step. axle: distance of the wheels, cm. side: of the torus, cm.
        room: what it goes at most, cm; it turns all the same.
    """
    way = torch.minimum(straight(left, right, seconds), room)
    turned = heading + (right - left) / axle * seconds
    return (
        torch.remainder(x + way * cos(heading), side),
        torch.remainder(y + way * sin(heading), side),
        torch.remainder(turned, TURN),
    )


def in_disc(radius: Tensor, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """A uniform point of a disc round the origin (cm), from two numbers uniform in [0, 1)."""
    distance = radius * square_root(first)
    angle = TURN * second
    return distance * cos(angle), distance * sin(angle)


def within(dx: Tensor, dy: Tensor, distance: Tensor) -> Tensor:
    """Whether a way (cm) is shorter than a distance."""
    return dx * dx + dy * dy < distance * distance


def orbit(slow: float, fast: float, seconds: float, axle: float) -> tuple[float, float]:
    """The regular polygon that a robot drives with its wheels at two constant speeds (cm/s).

    Returns the distance of the corners from the centre (cm) and the turn at each corner (rad).
    """
    turn = (fast - slow) / axle * seconds
    return 0.25 * (slow + fast) * seconds / float(sin(torch.tensor(0.5 * turn, dtype=torch.float64))), turn


def escape_radius(slow: float, fast: float, seconds: float, axle: float) -> float:
    """Distance from the centre of an `orbit` (cm) at which a robot has left it: twice its radius."""
    return 2 * orbit(slow, fast, seconds, axle)[0]
