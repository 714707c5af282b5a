"""Dampening: competition among the synapses of a named set (thesis 3.9)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def lowered(weight: Tensor, step: float, least: float) -> Tensor:
    """A weight (mV) one step lower, but not below the least one."""
    return torch.where(weight - step > least, weight - step, least)


@dataclass(frozen=True)
class Homeostasis:
    """When a set's mean weight exceeds `limit`, all its weights are lowered by `step`, not below their least.

    Attributes:
        projections: names of the plastic projections that make up the set.
        limit, step: mV.
        count_absent: whether pairs without a synapse count as zeros in the mean.
    """

    projections: tuple[str, ...]
    limit: float
    step: float
    count_absent: bool
