"""What one thread needs to run trials: the whole state of a trial, laid out for vectors, and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from snnrl.engines.fused.vectors import LANES
from snnrl.engines.layout import DELAYED, MILLISECONDS, SIZE, SOURCES, SOURCES_END, WIDTH, Tables

CACHE_LINE = 64  # bytes
NOISY = MILLISECONDS + 6  # rows of noise: they are drawn four at a time


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
    last: Any  # int64 [places, and a vector's room], last spikes
    earlier: Any  # int64 [places, and a vector's room], last spikes before this ms
    pending: Any  # real [L * places]
    fed: Any  # bool [L * blocks], whether anything is pending for a block
    still: Any  # bool [blocks], whether a block's neurons stay as they are while nothing reaches them
    background: Any  # real [places], constant currents, and behind them rows of a block of ms, of restless blocks
    injected: Any  # real [MILLISECONDS or a tick, places]
    drawn: Any  # int64 [places], random numbers of a group
    spikes: Any  # int64 [places], places of those who fired in this ms
    first: Any  # int64 [G + 1], where each group's spikes begin in `spikes`
    rise: Any  # real [places + rises], what a postsynaptic spike now adds, by presynaptic neuron
    fall: Any  # real [places], what a presynaptic spike now adds, by postsynaptic neuron
    tiles: Any  # real [tiles * 2 * LANES], see `snnrl.engines.fused.tiles`
    row_settled: Any  # real [tile_rows], the drive at a postsynaptic neuron's last spike
    column_settled: Any  # real [places + rises], and at a presynaptic one's
    masks: Any  # int64 [tiles], a bit for each pair that has a synapse
    lanes: Any  # int64, a bit for each presynaptic neuron that fires, by tile of a row
    rows: Any  # real, weights of dense projections that do not learn
    drive: Any  # real [Sg], see `snnrl.engines.fused.plasticity`
    before: Any  # real [Sg]
    signal: Any  # real [Sg], what synapses listen to in this ms
    positive: Any  # bool [Sg]
    weights: Any  # float64 [K], sum of each set's weights when they were last settled
    rising: Any  # float64 [K], how fast it can rise at most
    reach: Any  # float64 [1], the farthest drive up to which no set can have passed its limit
    level: Any  # real [M, but at least 1], of the trial's modulators
    total: Any  # float64 [M]
    rate: Any  # real, of their sources
    released: Any  # int64, their sources' spikes on the way


def work_for(tables: Tables, columns: int, slots: int, rows: int, real: Any) -> Work:
    """A thread's room for one trial at a time; `rows` ms of injected current."""
    places, blocks, sources = tables.places, tables.places // LANES, tables.modulators[:, SOURCES_END]
    rooms = {
        "cells": columns * places,
        "pending": slots * places,
        "background": places + NOISY * int(tables.background_step.max(initial=0)),
        "injected": rows * places,
        "rise": places + tables.rises,
        "fall": places,
        "tiles": 2 * LANES * tables.tiles,
        "row_settled": tables.tile_rows,
        "column_settled": places + tables.rises,
        "rows": tables.dense,
    }
    signals, sets = len(tables.signals), len(tables.set_step)
    on_the_way = tables.modulators[:, DELAYED] * (sources - tables.modulators[:, SOURCES])
    return Work(
        **_side_by_side(rooms, real),
        last=np.zeros(places + LANES, np.int64),
        earlier=np.zeros(places + LANES, np.int64),
        fed=np.zeros(slots * blocks, bool),
        still=np.zeros(blocks, bool),
        drawn=np.zeros(tables.groups[:, SIZE].max(initial=0) + LANES, np.int64),
        spikes=np.zeros(places, np.int64),
        first=np.zeros(len(tables.groups) + 1, np.int64),
        masks=np.zeros(tables.tiles, np.int64),
        lanes=np.zeros(tables.matrices[:, WIDTH].max(initial=0), np.int64),
        drive=np.zeros(signals, real),
        before=np.zeros(signals, real),
        signal=np.zeros(signals, real),
        positive=np.zeros(signals, bool),
        weights=np.zeros(sets),
        rising=np.zeros(sets),
        reach=np.zeros(1),
        level=np.zeros(tables.signals.shape[1], real),
        total=np.zeros(len(sources)),
        rate=np.zeros(sources.max(initial=0), real),
        released=np.zeros(int(on_the_way.sum()), np.int64),
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
