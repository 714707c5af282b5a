"""What a block of threads works with: a network's tensors, which synapses a neuron receives, and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from snnrl.engines.layout import BOUNDS, NOISE_GROUP, NONE, RULE, SET, SIGNAL, SOURCES_END, WEIGHT_RULE, Tables
from snnrl.model.network import Network

# columns of Wiring.runs
BY, HEARS, IN_SET, BY_WEIGHT_RULE, BOUNDS_AT = range(5)
SLICE = 32  # neurons whose synapses are side by side: a warp's


class State(NamedTuple):
    """A network's tensors as arrays, see `Network`; of all modulators side by side. R sources of releases in all."""

    packed: Any  # real [C, B, N]
    last_spike: Any
    pending: Any
    spike_count: Any
    weight: Any  # real [S]
    eligibility: Any
    level: Any  # real [B, M, but at least 1]
    total: Any  # float64 [B, M]
    rate: Any  # real [B, R]
    released: Any  # int64 [B, R's delay lines end to end]


class Wiring(NamedTuple):
    """What `Tables` do not say. A trial's synapses are counted from 0, those of a run side by side: their `place`.

    A run is what learns alike: by one rule, listening to the same, in one set. Behind the R runs are the synapses that
    do not learn. Numbers that are stored are unsigned and as small as they can be: an index that cannot be negative
    is cheaper, and there are many.
    """

    runs: Any  # int64 [R, 5]
    decay: Any  # real [R], what a ms leaves of an eligibility
    begins: Any  # int64 [B, R + 1], place of the first of each run, and of those that do not learn
    least: Any  # real [R], the least weight
    at: Any  # int32 [B, S], where a place is among all synapses of the network
    pre: Any  # [B, L], of synapses that learn
    post: Any  # [B, L]
    entering: Any  # int32 [B, N], how many synapses each neuron has
    slices: Any  # int64 [B, N / SLICE], where the first ones of so many neurons begin in what follows:
    source: Any  # presynaptic neurons, in the network's order of synapses; the next of a neuron is SLICE further on
    place: Any
    delay: Any  # ms
    sends: Any  # bool [N], whether any synapse leaves it
    noisy: Any  # bool [N], whether the background is
    noises: Any  # int64 [G + 1], where each group's begin in `noise`
    noise: Any  # int64 [Q], rows of `Tables.noises`, group by group, uniform ones before Gaussian ones and kicks


class Work(NamedTuple):
    """A block's; the same for all of its threads but for `lane`."""

    lane: Any  # which of the threads
    lanes: Any  # how many
    weight: Any  # real [L], by place
    eligibility: Any  # real [L]
    partial: Any  # float64 [R * lanes], of sums of weights
    injected: Any  # real [N], current from outside in this ms
    held: Any  # real [N], that of it which stays for all ms of a tick
    fired: Any  # bool [N]
    earlier: Any  # int64 [N], of those that fired, the last spike before this ms
    spikes: Any  # int64 [G], of each group in this ms
    over: Any  # bool [K], whether a set is above its limit
    signal: Any  # real [Sg], what synapses listen to
    level: Any  # of the trial's modulators, see `State`
    total: Any
    rate: Any
    released: Any
    touched: Any  # int64 [K], how often each kind of object was touched in this tick
    seen: Any  # float64 [range sensors, 2], with what left and right answer
    motor: Any  # int64 [1], the group that explores
    sign: Any  # real [1], of releases


class Scratch(NamedTuple):
    """Room for what is in `Work`, of all trials, [B, ...]; the first three only if a block has no room for them."""

    weight: Any
    eligibility: Any
    partial: Any
    sizes: Any  # (L, R * lanes)
    injected: Any
    held: Any
    fired: Any
    earlier: Any
    spikes: Any
    over: Any
    signal: Any
    touched: Any
    seen: Any
    motor: Any
    sign: Any


def wiring_of(network: Network, tables: Tables) -> Wiring:
    """The wiring of a network."""
    table, projections, trials = network.synapses, list(network.projections.values()), network.trials
    learnt = [tuple(row) for row in tables.projections[:, [RULE, SIGNAL, SET]].tolist()]
    runs = list(dict.fromkeys(run for run in learnt if run[0] != NONE))
    run_of = np.array([runs.index(run) if run in runs else len(runs) for run in learnt], np.int64)
    sizes = np.array([projection.count.cpu().numpy() for projection in projections], np.int64).reshape(-1, trials)
    # of each synapse, in the network's order: its trial, its run, and in a stable order of both its place
    trial = np.repeat(np.tile(np.arange(trials), len(projections)), sizes.ravel())
    run = np.repeat(np.repeat(run_of, trials), sizes.ravel())
    counts = np.zeros((trials, len(runs) + 1), np.int64)
    np.add.at(counts, (trial, run), 1)
    begins = np.cumsum(counts, 1) - counts
    count = counts.sum(1)
    order = np.lexsort((run, trial))
    place = np.empty(len(trial), np.int64)
    place[order] = np.arange(len(trial)) - np.repeat(np.cumsum(count) - count, count)
    at = np.zeros((trials, count.max(initial=0)), np.int32)
    at[trial, place] = np.arange(len(trial))
    ends = [(end % network.size).cpu().numpy() for end in (table.pre, table.post)]
    ends_learnt = np.zeros((2, trials, begins[:, -1].max(initial=0)), smallest(network.size))
    learns = run < len(runs)
    ends_learnt[:, trial[learns], place[learns]] = [end[learns] for end in ends]
    noisy = tables.noises[:, NOISE_GROUP]
    return Wiring(
        runs=np.array([(*run, *tables.rules[run[0], [WEIGHT_RULE, BOUNDS]]) for run in runs], np.int64).reshape(-1, 5),
        decay=tables.fading[[rule for rule, _, _ in runs], 1],
        begins=begins,
        least=tables.least[[rule for rule, _, _ in runs]],
        at=at,
        pre=ends_learnt[0],
        post=ends_learnt[1],
        **_entering(network, trial, *ends, place, table.delay.cpu().numpy()),
        sends=np.isin(np.arange(network.size), ends[0]),
        noisy=np.isin(tables.group_of, noisy),
        noises=np.searchsorted(np.sort(noisy), np.arange(len(network.groups) + 1)),
        noise=np.argsort(noisy, kind="stable"),
    )


def _entering(network: Network, trial: Any, pre: Any, post: Any, place: Any, delay: Any) -> dict[str, Any]:
    """The synapses of each neuron, so that those of SLICE neighbours lie side by side."""
    slices = -(-network.size // SLICE)
    entering = np.zeros((network.trials, network.size), np.int32)
    np.add.at(entering, (trial, post), 1)
    padded = np.zeros((network.trials, slices * SLICE), np.int64)
    padded[:, : network.size] = entering
    rows = padded.reshape(-1, SLICE).max(1)
    begins = (np.cumsum(rows) - rows) * SLICE
    order = np.lexsort((post, trial))
    counts = entering.ravel()
    number = np.arange(len(post)) - np.repeat(np.cumsum(counts) - counts, counts)  # among those of its neuron
    where = begins[trial[order] * slices + post[order] // SLICE] + number * SLICE + post[order] % SLICE
    values = {}
    for name, value in (("source", pre), ("place", place), ("delay", delay)):
        values[name] = np.zeros(int(rows.sum()) * SLICE, smallest(int(value.max(initial=0)) + 1))
        values[name][where] = value[order]
    return {"entering": entering, "slices": begins.reshape(network.trials, slices), **values}


def smallest(count: int) -> Any:
    """The smallest unsigned type that counts so many."""
    return np.min_scalar_type(max(count - 1, 0))


def scratch_for(
    network: Network, wiring: Wiring, on_chip: bool, signals: int, lanes: int, kinds: int, sensors: int
) -> Scratch:
    """Room for all trials, as tensors."""

    def room(size: int, dtype: torch.dtype) -> Tensor:
        return torch.zeros(network.trials, size, dtype=dtype, device=network.device)

    sizes = sizes_of(wiring, lanes)
    learnt, sums = (0, 0) if on_chip else sizes
    return Scratch(
        weight=room(learnt, network.dtype),
        eligibility=room(learnt, network.dtype),
        partial=room(sums, torch.float64),
        sizes=sizes,
        injected=room(network.size, network.dtype),
        held=room(network.size, network.dtype),
        fired=room(network.size, torch.bool),
        earlier=room(network.size, torch.int64),
        spikes=room(len(network.groups), torch.int64),
        over=room(len(network.homeostasis), torch.bool),
        signal=room(signals, network.dtype),
        touched=room(kinds, torch.int64),
        seen=room(2 * sensors, torch.float64).view(network.trials, sensors, 2),
        motor=room(1, torch.int64),
        sign=room(1, network.dtype),
    )


def sizes_of(wiring: Wiring, lanes: int) -> tuple[int, int]:
    """How many synapses that learn and parts of sums of their weights a trial has."""
    return wiring.pre.shape[1], len(wiring.runs) * lanes


def side_by_side(network: Network, tables: Tables) -> dict[str, Tensor]:
    """The state of all modulators, as `State` has it; copies."""
    modulators, trials = list(network.modulators.values()), network.trials
    if not modulators:
        level = network.pending.new_zeros(trials, 1)
        return {"level": level, "total": level.double(), "rate": level[:, :0], "released": level[:, :0].long()}
    found = {
        "level": torch.stack([m.level for m in modulators], 1),
        "total": torch.stack([m.total for m in modulators], 1),
        "rate": torch.cat([m.rate for m in modulators], 1),
        "released": torch.cat([m.pending.flatten(1) for m in modulators], 1),
    }
    assert found["rate"].shape[1] == tables.modulators[:, SOURCES_END].max(initial=0)
    return found


def put_back(network: Network, state: dict[str, Tensor]) -> None:
    """What `side_by_side` gave, to the modulators."""
    at, slot = 0, 0
    for k, modulator in enumerate(network.modulators.values()):
        modulator.level.copy_(state["level"][:, k])
        modulator.total.copy_(state["total"][:, k])
        sources = len(modulator.sources)
        modulator.rate.copy_(state["rate"][:, at : at + sources])
        size = sources * modulator.delay
        modulator.pending.copy_(state["released"][:, slot : slot + size].view_as(modulator.pending))
        at, slot = at + sources, slot + size
