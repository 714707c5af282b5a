"""Steps 1 and 2 of `Network.step`: input and neurons, LANES at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.fused.draws import add_gaussian, add_kicks, fill_noise
from snnrl.engines.fused.vectors import LANES, load, lowest_bit, mask_bits, store
from snnrl.engines.fused.work import NOISY
from snnrl.engines.layout import NOISE_AT, NOISE_SIZE, NOISE_STREAM, Functions


@placeholder
def step_cells(model, cells, at, places, current):
    """One ms of the block at `at`; returns two vectors' worth: who fired, and whether the state stayed the same."""


def fill_cells(t, s, w, trial):
    """Lay out the neurons of a trial; unused places get the state of a neuron beside them."""
    slots, step = s.pending.shape[1], noise_step(t)
    for c in range(s.packed.shape[0]):
        n = 0
        for place in range(t.places):
            n = t.neuron_of[place] if t.neuron_of[place] >= 0 else n
            w.cells[c * t.places + place] = s.packed[c, trial, n]
    w.fed[:] = True
    w.still[:] = False
    w.injected[:] = 0.0
    for place in range(t.places):
        n, block = t.neuron_of[place], place // LANES
        for k in range(NOISY if t.background_step[block] else 1):
            w.background[t.background_at[block] + place % LANES + k * step] = t.background[place]
        if n >= 0:
            w.last[place] = w.earlier[place] = s.last_spike[trial, n]
            for slot in range(slots):
                w.pending[slot * t.places + place] = s.pending[trial, slot, n]


def empty_cells(t, s, w, trial):
    """Put the neurons of a trial back where they were."""
    slots = s.pending.shape[1]
    for place in range(t.places):
        n = t.neuron_of[place]
        if n >= 0:
            s.last_spike[trial, n] = w.last[place]
            for c in range(s.packed.shape[0]):
                s.packed[c, trial, n] = w.cells[c * t.places + place]
            for slot in range(slots):
                s.pending[trial, slot, n] = w.pending[slot * t.places + place]


def noise_step(t):
    """From a noisy background current to that of the next ms; 0 if there is none."""
    step = 0
    for block in range(t.places // LANES):
        step = max(step, t.background_step[block])
    return step


def draw_noise(t, w, trial, time, steps):
    """Background currents of the noisy groups for a block of ms; returns the row of the first."""
    step = noise_step(t)
    for q in range(t.noises.shape[0]):
        at, size, stream = t.places + t.noises[q, NOISE_AT], t.noises[q, NOISE_SIZE], t.noises[q, NOISE_STREAM]
        one, other, number = t.noise_values[q, 0], t.noise_values[q, 1], t.trials[trial]
        if q < t.uniform:
            fill_noise(w.background, at, step, size, t.seed, stream, number, time, steps, one, other)
        elif q < t.gaussian:
            add_gaussian(w.background, at, step, size, t.seed, stream, number, time, steps, one)
        else:
            add_kicks(w.background, at, step, size, t.seed, stream, number, time, steps, one, int(other))
    return time & 3


def update_cells(t, w, slot, noise, row, low, high):
    """One ms of all neurons; who fired goes to `spikes`, their number is returned.

    A block whose neurons stay exactly as they are while nothing reaches them is passed over until something does.

    Args:
        slot: of what arrives now.
        noise: row of the noisy background currents.
        row: of the injected current, whose blocks from low to high (not included) are not 0.
    """
    blocks = t.places // LANES
    found = 0
    for b in range(blocks):
        fed, driven = w.fed[slot * blocks + b], low <= b < high
        if w.still[b] and not fed and not driven:
            continue
        at, step = b * LANES, t.background_step[b]
        inflow = load(w.background, t.background_at[b] + noise * step)
        if fed:
            here = slot * t.places + at
            inflow = load(w.pending, here) + inflow
            store(w.pending, here, inflow * 0.0)
            w.fed[slot * blocks + b] = False
        if driven:
            inflow = inflow + load(w.injected, row * t.places + at)
        fired, same = step_cells(t.model_of[b], w.cells, at, t.places, inflow)
        w.still[b] = same and not fed and not driven and step == 0
        bits = mask_bits(fired) & t.valid[b]
        while bits:
            w.spikes[found] = at + lowest_bit(bits)
            found += 1
            bits &= bits - 1
    return found


def sort_spikes(t, s, w, trial, now, found):
    """Note who fired in this ms, and where each group's spikes begin."""
    n = 0
    for g in range(t.groups.shape[0]):
        w.first[g] = n
        while n < found and t.group_of[w.spikes[n]] == g:
            n += 1
        s.spike_count[trial, g] += n - w.first[g]
    w.first[t.groups.shape[0]] = n
    for n in range(found):
        w.last[w.spikes[n]] = now


def stepping(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `step_cells` and the names in it stand for in a network of those models."""
    calls, names = [], {}
    for k, model in enumerate(functions.models):
        names[f"model_{k}"] = model.step
        at = {name: f"at + {functions.columns.index(name)} * places" for name in model.columns}
        state = ", ".join(f"x{i}" for i in range(len(model.state)))
        after = ", ".join(f"y{i}" for i in range(len(model.state)))
        given = "".join(f", load(cells, {at[name]})" for name in model.parameters)
        lines = [f"if model == {k}:"]
        lines += [f"    x{i} = load(cells, {at[name]})" for i, name in enumerate(model.state)]
        lines += [f"    {after}, fired = model_{k}({state}, current{given})"]
        lines += [f"    store(cells, {at[name]}, y{i})" for i, name in enumerate(model.state)]
        same = " & ".join(f"(x{i} == y{i})" for i in range(len(model.state)))
        lines += [f"    return fired, mask_bits({same}) == {(1 << LANES) - 1}"]
        calls += lines
    calls[-len(lines)] = "if True:"  # the last needs no question
    body = "\n".join(f"    {line}" for line in calls)
    scope = {"load": load, "store": store, "mask_bits": mask_bits}
    return {"step_cells": spelled("step_cells", "model, cells, at, places, current", body, scope), **names}
