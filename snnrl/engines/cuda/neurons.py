"""Steps 1 and 2 of `Network.step`: input and neurons, a thread for each.

Spikes are counted by atomic operations, on whole numbers: their order does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from snnrl.engines.cuda.compiler import count, mark, real
from snnrl.engines.cuda.shape import LANES, NEURONS
from snnrl.engines.cuda.work import REST, WORD
from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.fused.draws import UNIT, bits
from snnrl.engines.layout import NOISE_STREAM, SIZE, START, Functions
from snnrl.model.draws import bell
from snnrl.model.neurons import gaussian_noise, kicked, uniform_noise


@placeholder
def step_cell(model, packed, trial, n, current):
    """One ms of a neuron; returns whether it fired."""


def background(t, trial, n, now):
    """Background current of a neuron that has a noisy one."""
    tables, current, g = t.tables, t.tables.background[n], t.tables.group_of[n]
    seed, number, index = tables.seed, tables.trials[trial], n - tables.groups[g, START]
    for q in range(t.wiring.noises[g], t.wiring.noises[g + 1]):
        noise = t.wiring.noise[q]
        stream, one, other = (
            tables.noises[noise, NOISE_STREAM],
            tables.noise_values[noise, 0],
            tables.noise_values[noise, 1],
        )
        draw = bits(seed, stream, number, now, index)
        if noise < tables.uniform:
            current = uniform_noise(real(draw * UNIT), one, other)
        elif noise < tables.gaussian:
            size = tables.groups[g, SIZE]
            two, three, four = (
                bits(seed, stream, number, now, index + size),
                bits(seed, stream, number, now, index + 2 * size),
                bits(seed, stream, number, now, index + 3 * size),
            )
            current = gaussian_noise(current, real(bell(draw, two, three, four)), one)
        else:
            current = kicked(current, draw, int(other), one)
    return current


def update_cells(t, s, w, trial, now, slot, base, raster, row):
    """One ms of all neurons, whose current from outside is in `injected`.

    Who fired goes to `fired`, from `base` on; returns whether any of this thread's did.
    """
    shown = raster.shape[0] > 0 and trial < raster.shape[1]
    n, some = w.lane, False
    while n < NEURONS:
        current = s.pending[trial, slot, n]
        current += background(t, trial, n, now) if t.wiring.noisy[n] else t.tables.background[n]
        current += w.injected[n]
        s.pending[trial, slot, n] = 0.0
        fired = step_cell(t.tables.model_of[n], s.packed, trial, n, current)
        if fired:
            w.earlier[n] = s.last_spike[trial, n]
            s.last_spike[trial, n] = now
            mark(w.fired, base + (n >> WORD), np.uint32(1) << np.uint32(n & REST))
            count(w.spikes, t.tables.group_of[n])
            some = True
        if shown:
            raster[row, trial, n] = 1 if fired else 0
        n += LANES
    return some


def spikes_of(w, g):
    """How many of a group fired in this ms."""
    return w.spikes[g]


def stepping(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `step_cell` and the names in it stand for in a network of those models."""
    lines, names = [], {}
    for k, model in enumerate(functions.models):
        names[f"model_{k}"] = model.step
        at = {name: f"packed[{functions.columns.index(name)}, trial, n]" for name in model.columns}
        given = ", ".join([*(at[name] for name in model.state), "current", *(at[name] for name in model.parameters)])
        after = ", ".join(f"y{i}" for i in range(len(model.state)))
        last = k == len(functions.models) - 1  # which needs no question
        lines += ["if True:" if last else f"if model == {k}:"]
        lines += [f"    {after}, fired = model_{k}({given})"]
        lines += [f"    {at[name]} = y{i}" for i, name in enumerate(model.state)]
        lines += ["    return fired"]
    body = "\n".join(f"    {line}" for line in lines)
    return {"step_cell": spelled("step_cell", "model, packed, trial, n, current", body, {}), **names}
