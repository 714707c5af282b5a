"""What a block of threads works with: a network's tensors, which synapses a neuron receives, and scratch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from snnrl.engines.layout import NOISE_GROUP, SOURCES_END, Tables
from snnrl.model.network import Network


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
    """What `Tables` do not say. A trial's own synapses are counted from 0, in the network's order: their `place`."""

    begins: Any  # int64 [P, B], place of the first of each projection
    entering: Any  # int64 [B * N + 1], where each neuron's synapses begin in what follows, in the network's order:
    place: Any  # int32 [S]
    source: Any  # int32 [S], presynaptic neurons
    delay: Any  # int32 [S], ms
    least: Any  # real [P], the least weight
    noises: Any  # int64 [G + 1], where each group's begin in `noise`
    noise: Any  # int64 [Q], rows of `Tables.noises`, group by group, uniform ones before Gaussian ones and kicks
    synapses: Any  # the most that a trial has


class Work(NamedTuple):
    """A block's; the same for all of its threads but for `lane`."""

    lane: Any  # which of the threads
    lanes: Any  # how many, a power of two
    memory: Any  # real [2 * synapses], weights by place, and behind them eligibilities
    injected: Any  # real [N], current from outside in this ms
    fired: Any  # bool [N]
    earlier: Any  # int64 [N], last spikes before this ms
    first: Any  # int64 [G + 1], where each group's spikes begin among those of this ms
    latest: Any  # int64 [1], the last ms in which any neuron fired
    signal: Any  # real [Sg], what synapses listen to
    partial: Any  # float64 [lanes], of a sum
    level: Any  # of the trial's modulators, see `State`
    total: Any
    rate: Any
    released: Any
    touched: Any  # int64 [K], how often each kind of object was touched in this tick
    seen: Any  # float64 [range sensors, 2], with what left and right answer
    motor: Any  # int64 [1], the group that explores
    sign: Any  # real [1], of releases


class Scratch(NamedTuple):
    """Room for what is in `Work`, of all trials, [B, ...]."""

    memory: Any
    injected: Any
    fired: Any
    earlier: Any
    first: Any
    latest: Any
    signal: Any
    partial: Any
    touched: Any
    seen: Any
    motor: Any
    sign: Any


def wiring_of(network: Network, tables: Tables) -> Wiring:
    """The wiring of a network."""
    table, projections = network.synapses, list(network.projections.values())
    post = table.post.cpu().numpy()
    order = np.argsort(post, kind="stable")
    counts = np.array([projection.count.cpu().numpy() for projection in projections], np.int64)
    counts = counts.reshape(len(projections), network.trials)
    begins = np.cumsum(counts, 0) - counts
    # of each part of the table, one projection's synapses of one trial, how far its places are from where it stands
    shift = begins.ravel() - (np.cumsum(counts) - counts.ravel())
    place = np.arange(len(post)) + np.repeat(shift, counts.ravel())
    rules = [projection.rule for projection in projections]
    noisy = tables.noises[:, NOISE_GROUP]
    return Wiring(
        begins=begins,
        entering=np.searchsorted(post[order], np.arange(network.trials * network.size + 1)),
        place=place[order].astype(np.int32),
        source=tables.source[order],
        delay=table.delay.cpu().numpy()[order].astype(np.int32),
        least=np.array([0.0 if rule is None else rule.weight_min for rule in rules], tables.signals.dtype),
        noises=np.searchsorted(np.sort(noisy), np.arange(len(network.groups) + 1)),
        noise=np.argsort(noisy, kind="stable"),
        synapses=int(counts.sum(0).max(initial=0)),
    )


def scratch_for(network: Network, tables: Tables, memory: int, lanes: int, kinds: int, sensors: int) -> Scratch:
    """Room for all trials, as tensors."""

    def room(size: int, dtype: torch.dtype) -> Tensor:
        return torch.zeros(network.trials, size, dtype=dtype, device=network.device)

    return Scratch(
        memory=room(memory, network.dtype),
        injected=room(network.size, network.dtype),
        fired=room(network.size, torch.bool),
        earlier=room(network.size, torch.int64),
        first=room(len(tables.groups) + 1, torch.int64),
        latest=room(1, torch.int64),
        signal=room(len(tables.signals), network.dtype),
        partial=room(lanes, torch.float64),
        touched=room(kinds, torch.int64),
        seen=room(2 * sensors, torch.float64).view(network.trials, sensors, 2),
        motor=room(1, torch.int64),
        sign=room(1, network.dtype),
    )


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
