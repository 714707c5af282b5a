"""Range sensors; pure functions of geometry."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from snnrl.model.elementary import cos, sin


@dataclass(frozen=True)
class RangeSensor:
    """A left and a right eye, each seeing from straight ahead to 90 degrees on its side (thesis 3.2).

    Attributes:
        reach: distance (cm) at which the value has fallen from 1 to 0.
        to_border: whether distance is measured to the object's border rather than its centre.
    """

    reach: float
    to_border: bool


def sense(sensor: RangeSensor, way: Tensor, heading: Tensor, visible: Tensor, radius: float) -> Tensor:
    """Values of the left and the right eye, float64 [B, 2] in [0, 1].

    Each eye sees only its nearest object, and only the eye with the larger value answers; so what is
    sensed is the nearest of all objects ahead. Straight ahead is seen by the left eye.

    Args:
        way: from the robot to each object's centre, [B, M, 2], cm.
        heading: [B], rad.
        visible: which objects this sensor can see at all, bool [B, M].
        radius: of the objects, cm.
    """
    if way.shape[1] == 0:
        return way.new_zeros(len(way), 2)
    along, across = cos(heading)[:, None], sin(heading)[:, None]
    ahead = way[..., 0] * along + way[..., 1] * across >= 0.0
    leftward = way[..., 1] * along - way[..., 0] * across >= 0.0
    distance = torch.sqrt(way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1])
    distance = torch.where(visible & ahead, distance, torch.inf)
    nearest, which = distance.min(1)
    if sensor.to_border:
        nearest = (nearest - radius).clamp_min(0.0)
    value = (1.0 - nearest / sensor.reach).clamp_min(0.0)
    left = leftward.gather(1, which[:, None])[:, 0]
    return torch.stack([value * left, value * ~left], 1)
