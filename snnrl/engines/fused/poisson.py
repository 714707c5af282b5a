"""Poisson counts for means that differ from tick to tick: `snnrl.model.draws.poisson_of_means`, compiled."""

from __future__ import annotations

import torch

from snnrl.engines.fused.draws import UNIT
from snnrl.engines.fused.vectors import as_real, gather, select
from snnrl.model.draws import poisson_table_size
from snnrl.model.elementary import exp

PRECISION = torch.float64


def poisson_table(mean, table):
    """Cumulative probabilities, as far as a draw can reach."""
    probability, factor = exp(-mean), 1.0
    total = probability
    table[:] = 1.0
    table[0] = total
    for count in range(1, len(table)):
        factor *= mean / count
        total += probability * factor
        table[count] = total
        if total > 1.0 - 0.5 * UNIT:
            break


def room(largest):
    """Of a table for means up to `largest`: a power of two, as `look_up` needs it."""
    return 1 << poisson_table_size(largest).bit_length()


def look_up(table, drawn):
    """The first counts whose cumulative probabilities exceed a vector of draws, by halves of the table."""
    draw, count, step = as_real(drawn, 1.0) * UNIT, drawn - drawn, len(table) // 2
    while step > 0:
        count = select(gather(table, count + (step - 1)) <= draw, count + step, count)
        step //= 2
    return count
