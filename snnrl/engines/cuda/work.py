"""What a block of threads works with: a network's tensors, which synapses a neuron receives, and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from snnrl.engines.cuda.compiler import WARP
from snnrl.engines.layout import BOUNDS, NOISE_GROUP, NONE, RULE, SET, SIGNAL, SOURCES_END, WEIGHT_RULE, Tables
from snnrl.model.network import Network

# columns of Wiring.runs
BY, HEARS, IN_SET, BY_WEIGHT_RULE, BOUNDS_AT = range(5)
WORD, REST = 5, 31  # neurons are numbered in words of 2^WORD, whose bits say which of them have fired


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
    do not learn. Numbers that are stored are as small as they can be: there are many.

    Spikes are sent in phases, in each of which those of a neuron's sources are added in the order of the neurons.
    Together that is the reference's order, of the synapses. A network has few phases, the thesis's have one and two.
    """

    runs: Any  # int64 [R, 5]
    decay: Any  # real [R], what a ms leaves of an eligibility
    begins: Any  # int64 [B, R + 1], place of the first of each run, and of those that do not learn
    least: Any  # real [R], the least weight
    at: Any  # int32 [B, S], where a place is among all synapses of the network
    pre: Any  # [B, L], of synapses that learn
    post: Any  # [B, L]
    delay: Any  # ms [B, S]
    row_of: Any  # int64 [phases, N], which of a trial's rows has a neuron's synapses, -1 for none
    rows: Any  # [B, rows, N], of the synapse onto each neuron, one more than its place; 0 where there is none
    noisy: Any  # bool [N], whether the background is
    noises: Any  # int64 [G + 1], where each group's begin in `noise`
    noise: Any  # int64 [Q], rows of `Tables.noises`, group by group, uniform ones before Gaussian ones and kicks


class Work(NamedTuple):
    """A block's; the same for all of its threads but for `lane`."""

    lane: Any  # which of the threads
    weight: Any  # real [L], by place
    eligibility: Any  # real [L]
    partial: Any  # float64 [R * warps], of sums of weights
    fired: Any  # uint32 [2 * words], a bit for each neuron, in this ms and, when that has spikes, in the next
    spikes: Any  # uint32 [G], of each group in this ms
    injected: Any  # real [N], current from outside in this ms
    held: Any  # real [N], that of it which stays for all ms of a tick
    earlier: Any  # int64 [N], of those that fired, the last spike before this ms
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
    """Room for what is in `Work`, of all trials, [B, ...]; the first two only if a block has no room for them."""

    weight: Any
    eligibility: Any
    sizes: Any  # (L, R * warps)
    injected: Any
    held: Any
    earlier: Any
    signal: Any
    touched: Any
    seen: Any
    motor: Any
    sign: Any


def wiring_of(network: Network, tables: Tables) -> Wiring:
    """The wiring of a network, on its device."""
    table, projections, trials = network.synapses, list(network.projections.values()), network.trials
    learnt = [tuple(row) for row in tables.projections[:, [RULE, SIGNAL, SET]].tolist()]
    runs = list(dict.fromkeys(run for run in learnt if run[0] != NONE))
    row_of, first_row, height = rows_of(network)
    # of each projection's synapses: their run, and which of the trial's rows is that of its first neuron
    each = [[runs.index(run) if run in runs else len(runs) for run in learnt], first_row]
    nothing = torch.zeros(0, dtype=torch.long, device=network.device)
    sizes = torch.cat([nothing, *(projection.count for projection in projections)])  # projection by projection
    run, row = (torch.tensor(known, device=network.device).repeat_interleave(trials) for known in each)
    trial = torch.arange(trials, device=network.device).repeat(len(projections))
    counts = torch.zeros(trials, len(runs) + 1, dtype=torch.long, device=network.device)
    counts.index_put_((trial, run), sizes, accumulate=True)
    begins = counts.cumsum(1) - counts
    order = (trial * (len(runs) + 1) + run).repeat_interleave(sizes).argsort(stable=True)
    trial, row = trial.repeat_interleave(sizes), row.repeat_interleave(sizes)
    count = counts.sum(1)
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order), device=network.device) - (count.cumsum(0) - count)[trial[order]]

    def by_place(value: Tensor, largest: int) -> Tensor:
        room = torch.zeros(trials, int(count.max()), dtype=smallest(largest), device=network.device)
        room[trial, place] = value.to(room.dtype)
        return room

    pre, post = table.pre % network.size, table.post % network.size
    rows = torch.zeros(trials, height, network.size, dtype=smallest(int(count.max())), device=network.device)
    rows[trial, row + pre, post] = (place + 1).to(rows.dtype)
    noisy = tables.noises[:, NOISE_GROUP]
    most = max(int(begins[:, -1].max()), 1)
    return Wiring(
        runs=np.array([(*run, *tables.rules[run[0], [WEIGHT_RULE, BOUNDS]]) for run in runs], np.int64).reshape(-1, 5),
        decay=tables.fading[[rule for rule, _, _ in runs], 1],
        begins=begins,
        least=tables.least[[rule for rule, _, _ in runs]],
        at=by_place(torch.arange(len(order), device=network.device), len(order)),
        pre=by_place(pre, network.size)[:, :most].contiguous(),
        post=by_place(post, network.size)[:, :most].contiguous(),
        delay=by_place(table.delay, network.slots),
        row_of=row_of,
        rows=rows,
        noisy=np.isin(tables.group_of, noisy),
        noises=np.searchsorted(np.sort(noisy), np.arange(len(network.groups) + 1)),
        noise=np.argsort(noisy, kind="stable"),
    )


def rows_of(network: Network) -> tuple[np.ndarray, list[int], int]:
    """Of each neuron in each phase its row, see `Wiring`; of each projection the row that neuron 0 would have; height.

    A projection begins a new phase where its target has already had, in this one, neurons behind its own or the same.
    """
    zeros: list[int] = []
    phases: list[np.ndarray] = []
    latest: dict[str, int] = {}  # source of each target in this phase
    height = 0
    for projection in network.projections.values():
        source = network.groups[projection.pre]
        if not phases or source.start <= latest.get(projection.post, -1):
            phases.append(np.full(network.size, NONE, np.int64))
            latest = {}
        latest[projection.post] = source.start
        if phases[-1][source.start] == NONE:
            phases[-1][source.span] = np.arange(height, height + source.size)
            height += source.size
        zeros.append(int(phases[-1][source.start]) - source.start)
    return np.array(phases, np.int64).reshape(-1, network.size), zeros, height


def smallest(largest: int) -> torch.dtype:
    """The smallest type for whole numbers up to a largest one."""
    fitting = (dtype for dtype in (torch.uint8, torch.int16, torch.int32) if largest <= torch.iinfo(dtype).max)
    return next(fitting, torch.int64)


def scratch_for(
    network: Network, wiring: Wiring, on_chip: bool, signals: int, lanes: int, kinds: int, sensors: int
) -> Scratch:
    """Room for all trials, as tensors."""

    def room(size: int, dtype: torch.dtype) -> Tensor:
        return torch.zeros(network.trials, size, dtype=dtype, device=network.device)

    sizes = sizes_of(wiring, lanes)
    learnt = 0 if on_chip else sizes[0]
    return Scratch(
        weight=room(learnt, network.dtype),
        eligibility=room(learnt, network.dtype),
        sizes=sizes,
        injected=room(network.size, network.dtype),
        held=room(network.size, network.dtype),
        earlier=room(network.size, torch.int64),
        signal=room(signals, network.dtype),
        touched=room(kinds, torch.int64),
        seen=room(2 * sensors, torch.float64).view(network.trials, sensors, 2),
        motor=room(1, torch.int64),
        sign=room(1, network.dtype),
    )


def sizes_of(wiring: Wiring, lanes: int) -> tuple[int, int]:
    """How many synapses that learn and parts of sums of their weights a trial has."""
    return wiring.pre.shape[1], len(wiring.runs) * lanes // WARP


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
