"""What one thread needs to run trials: the whole state of a trial, laid out for vectors, and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from snnrl.engines.fused.draws import drawn_width
from snnrl.engines.fused.vectors import LANES
from snnrl.engines.layout import MILLISECONDS, NOISE_SIZE, Tables

CACHE_LINE = 64  # bytes


class State(NamedTuple):
    """A network's tensors as arrays, [B, ...]; see `Network`. The modulators' are tuples of M arrays."""

    packed: Any
    last_spike: Any
    pending: Any
    spike_count: Any
    weight: Any
    eligibility: Any
    settled: Any  # real [S], of synapses that are kept as lists: see `snnrl.engines.fused.plasticity`
    level: Any
    total: Any
    released: Any  # int64 [B, K, delay]
    rate: Any


class Work(NamedTuple):
    """One thread's; reals are of the network's precision, places are those of `Tables`."""

    cells: Any  # real [C * places], state and parameters of the trial's neurons
    last: Any  # int64 [places], last spikes
    earlier: Any  # int64 [places], last spikes before this ms
    pending: Any  # real [L * places]
    fed: Any  # bool [L * blocks], whether anything is pending for a block
    still: Any  # bool [blocks], whether a block's neurons stay as they are while nothing reaches them
    background: Any  # real [places]
    noise: Any  # real, background currents of a block of ms
    injected: Any  # real [MILLISECONDS or a tick, places]
    spikes: Any  # int64 [places], places of those who fired in this ms
    first: Any  # int64 [G + 1], where each group's spikes begin in `spikes`
    rise: Any  # real [places], what a postsynaptic spike now adds, by presynaptic neuron
    fall: Any  # real [places], what a presynaptic spike now adds, by postsynaptic neuron
    dense: Any  # real, rows of all pairs: weight, and where they learn eligibility and `settled`
    masks: Any  # int64, a bit for each pair that has a synapse
    drive: Any  # real [Sg], see `snnrl.engines.fused.plasticity`
    before: Any  # real [Sg]
    positive: Any  # bool [Sg]
    weights: Any  # float64 [K], sum of each set's weights at the last flush
    rising: Any  # float64 [K], how fast it can rise at most


def work_for(tables: Tables, columns: int, slots: int, rows: int, real: Any) -> Work:
    """A thread's room for one trial at a time; `rows` ms of injected current."""
    places, blocks = tables.places, tables.places // LANES
    rooms = {
        "cells": columns * places,
        "pending": slots * places,
        "background": places,
        "noise": sum((MILLISECONDS + 6) * drawn_width(int(size)) for size in tables.noises[:, NOISE_SIZE]),
        "injected": rows * places,
        "rise": places,
        "fall": places,
        "dense": tables.dense,
    }
    return Work(
        **_side_by_side(rooms, real),
        last=np.zeros(places, np.int64),
        earlier=np.zeros(places, np.int64),
        fed=np.zeros(slots * blocks, bool),
        still=np.zeros(blocks, bool),
        spikes=np.zeros(places, np.int64),
        first=np.zeros(len(tables.groups) + 1, np.int64),
        masks=np.zeros(tables.masks, np.int64),
        drive=np.zeros(len(tables.signals), real),
        before=np.zeros(len(tables.signals), real),
        positive=np.zeros(len(tables.signals), bool),
        weights=np.zeros(len(tables.set_step)),
        rising=np.zeros(len(tables.set_step)),
    )


def _side_by_side(rooms: dict[str, int], real: Any) -> dict[str, Any]:
    """Arrays of so many reals, each with a vector's room behind it, in one piece of memory at cache lines."""
    line = CACHE_LINE // np.dtype(real).itemsize
    sizes = {name: -(-(size + LANES) // line) * line for name, size in rooms.items()}
    memory = np.zeros(sum(sizes.values()) + line, real)
    at = -(memory.ctypes.data // memory.itemsize) % line
    arrays = {}
    for name, size in sizes.items():
        arrays[name], at = memory[at : at + size], at + size
    return arrays
