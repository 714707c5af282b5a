"""Positions on a square torus (cm) and the two-wheeled robot's motion; pure functions."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from snnrl.model.elementary import cos, sin


def offset(origin: Tensor, target: Tensor, side: float) -> Tensor:
    """Shortest way from origin to target, both in [0, side]; each component in [-side/2, side/2)."""
    way = target - origin
    way = torch.where(way >= 0.5 * side, way - side, way)
    return torch.where(way < -0.5 * side, way + side, way)


def drive(
    position: Tensor, heading: Tensor, wheels: Tensor, seconds: float, axle: float, side: float
) -> tuple[Tensor, Tensor]:
    """One Euler step of a two-wheeled robot: first along the old heading, then the turn.

    Args:
        position: [B, 2], cm. heading: [B], rad, anticlockwise from the x axis.
        wheels: [B, 2], speed of the left and the right wheel, cm/s.
        seconds: the step. axle: distance of the wheels, cm. side: of the torus, cm.
    """
    left, right = wheels.unbind(1)
    way = 0.5 * (left + right) * seconds
    step = torch.stack([way * cos(heading), way * sin(heading)], 1)
    turned = heading + (right - left) / axle * seconds
    return torch.remainder(position + step, side), torch.remainder(turned, 2.0 * math.pi)


def orbit(slow: float, fast: float, seconds: float, axle: float) -> tuple[float, float]:
    """The regular polygon that a robot drives with its wheels at two constant speeds (cm/s).

    Returns the distance of the corners from the centre (cm) and the turn at each corner (rad).
    """
    turn = (fast - slow) / axle * seconds
    return 0.25 * (slow + fast) * seconds / float(sin(torch.tensor(0.5 * turn, dtype=torch.float64))), turn


def in_disc(radius: float, uniform: Tensor) -> Tensor:
    """Uniform points of a disc round the origin from two uniform numbers, [..., 2] to [..., 2]."""
    distance = radius * torch.sqrt(uniform[..., 0])
    angle = 2.0 * math.pi * uniform[..., 1]
    return torch.stack([distance * cos(angle), distance * sin(angle)], -1)
