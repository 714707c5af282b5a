"""Positions on a square torus (cm) and the two-wheeled robot's motion; pure elementwise functions of numbers."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from snnrl.model.elementary import cos, sin, square_root

PRECISION = torch.float64
TURN = 2.0 * math.pi


def offset(origin: Tensor, target: Tensor, side: float) -> Tensor:
    """Shortest way from origin to target along one axis, both in [0, side]; in [-side/2, side/2)."""
    way = target - origin
    way = torch.where(way >= 0.5 * side, way - side, way)
    return torch.where(way < -0.5 * side, way + side, way)


def drive(
    x: Tensor, y: Tensor, heading: Tensor, left: Tensor, right: Tensor, seconds: float, axle: float, side: float
) -> tuple[Tensor, Tensor, Tensor]:
    """One Euler step of a two-wheeled robot: first along the old heading, then the turn.

    Args:
        x, y: cm. heading: rad, anticlockwise from the x axis.
        left, right: speed of the wheels, cm/s.
        seconds: the step. axle: distance of the wheels, cm. side: of the torus, cm.
    """
    way = 0.5 * (left + right) * seconds
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
