"""Steps 1 and 2 of `Network.step`: input and neurons, LANES at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.fused.draws import drawn_width, fill_noise
from snnrl.engines.fused.vectors import DRAWN, LANES, load, load_drawn, lowest_bit, mask_bits, store
from snnrl.engines.layout import MILLISECONDS, NOISE_PLACE, NOISE_SIZE, NOISE_STREAM, Functions


@placeholder
def step_cells(model, cells, at, places, current):
    """One ms of the block at `at`; returns two vectors' worth: who fired, and whether the state stayed the same."""


def draw_noise(t, w, trial, time, steps):
    """Background currents of the noisy groups for a block of ms; returns how many rows to skip."""
    at = 0
    for q in range(t.noises.shape[0]):
        width = drawn_width(t.noises[q, NOISE_SIZE])
        current, amplitude = t.noise_values[q, 0], t.noise_values[q, 1]
        stream = t.noises[q, NOISE_STREAM]
        fill_noise(w.noise, at, width, t.seed, stream, t.trials[trial], time, steps, current, amplitude)
        at += (MILLISECONDS + 6) * width
    return time & 3


def put_noise(t, w, row):
    """The background of the noisy groups in one ms."""
    at = 0
    for q in range(t.noises.shape[0]):
        size, place = t.noises[q, NOISE_SIZE], t.noises[q, NOISE_PLACE]
        width = drawn_width(size)
        here = at + row * width
        whole = size // DRAWN * DRAWN
        for i in range(0, whole, DRAWN):
            store(w.background, place + i, load_drawn(w.noise, here + i))
        for i in range(whole, size):
            w.background[place + i] = w.noise[here + i]
        at += (MILLISECONDS + 6) * width


def update_cells(t, w, slot, row, low, high):
    """One ms of all neurons; who fired goes to `spikes`, their number is returned.

    A block whose neurons stay exactly as they are while nothing reaches them is passed over until something does.

    Args:
        slot: of what arrives now.
        row: of the injected current, whose blocks from low to high (not included) are not 0.
    """
    blocks = t.places // LANES
    found = 0
    for b in range(blocks):
        fed, driven = w.fed[slot * blocks + b], low <= b < high
        if w.still[b] and not fed and not driven:
            continue
        at = b * LANES
        inflow = load(w.background, at)
        if fed:
            here = slot * t.places + at
            inflow = load(w.pending, here) + inflow
            store(w.pending, here, inflow * 0.0)
            w.fed[slot * blocks + b] = False
        if driven:
            inflow = inflow + load(w.injected, row * t.places + at)
        fired, same = step_cells(t.model_of[b], w.cells, at, t.places, inflow)
        w.still[b] = same and not fed and not driven and not t.restless[b]
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
