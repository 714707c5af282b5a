"""Poisson counts for means that differ from tick to tick: `snnrl.model.draws.poisson_of_means`, compiled."""

from __future__ import annotations

import torch

from snnrl.engines.fused.draws import UNIT
from snnrl.model.elementary import exp

PRECISION = torch.float64


def poisson_table(mean, table):
    """Cumulative probabilities, as far as a draw can reach."""
    probability, factor = exp(-mean), 1.0
    table[:] = 1.0
    table[0] = probability
    for count in range(1, len(table)):
        factor *= mean / count
        table[count] = table[count - 1] + probability * factor
        if table[count] > 1.0 - 0.5 * UNIT:
            break


def look_up(table, draw, mean):
    """The first count whose cumulative probability exceeds the draw, sought from the mean."""
    count = int(mean)
    while table[count] <= draw:
        count += 1
    while count > 0 and table[count - 1] > draw:
        count -= 1
    return count
