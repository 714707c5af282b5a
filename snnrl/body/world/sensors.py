"""Range sensors: a left and a right eye, each seeing from straight ahead to 90 degrees on its side (thesis 3.2).

Each eye sees only its nearest object, and either both answer or only the eye with the larger value: what is then sensed
is the nearest of all objects ahead. Straight ahead is seen by the left eye. Pure elementwise functions of numbers.
"""

from __future__ import annotations

import torch
from torch import Tensor

from snnrl.model.elementary import square_root

PRECISION = torch.float64


def faces(dx: Tensor, dy: Tensor, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
    """Whether an object is ahead, and whether it is on the left.

    Args:
        dx, dy: the way from the robot to its centre, cm.
        along, across: cosine and sine of the robot's heading.
    """
    return dx * along + dy * across >= 0.0, dy * along - dx * across >= 0.0


def distance_to(dx: Tensor, dy: Tensor, inner: Tensor) -> Tensor:
    """How far an object is (cm), measured to where it begins: `inner` cm from its centre."""
    return square_root(dx * dx + dy * dy) - inner


def range_value(distance: Tensor, reach: float) -> Tensor:
    """1 at an object, falling to 0 at `reach` cm; an infinite distance is no object."""
    value = 1.0 - torch.where(distance > 0.0, distance, 0.0) / reach
    return torch.where(value > 0.0, value, 0.0)
