"""Poisson counts for means that differ from tick to tick: `snnrl.model.draws.poisson_of_means`, one at a time."""

from __future__ import annotations

import torch

from snnrl.model.elementary import exp

PRECISION = torch.float64


def poisson_of_mean(draw, mean, largest):
    """The first count whose cumulative probability exceeds the draw; `largest` at most."""
    first, factor, count = exp(-mean), 1.0, 0
    cumulative = first
    while cumulative <= draw and count < largest:
        count += 1
        factor *= mean / count
        cumulative += first * factor
    return count
