"""Binds modules to the compiled kernels and spreads trials over threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn

from snnrl.body.coding import Coding
from snnrl.body.world import TOUCHES, RangeSensor, World
from snnrl.configuration.schema import ConfigError
from snnrl.engines.fused.network import BLOCK, NetworkArrays, run_network
from snnrl.engines.fused.world import CodingArrays, WorldArrays, run_ticks
from snnrl.model.draws import poisson_table_size, stream
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.modulators import Dopamine
from snnrl.model.network import Network, SynapseTable
from snnrl.model.neurons import CONSTANT, LINEAR, PEAK, SQUARE, NeuronGroup
from snnrl.model.synapses import Plasticity, Projection, stdp
from snnrl.simulation import Simulation

FORGOTTEN = 100  # in units of tau: older pairs add less than 1e-43 of their amplitude
PARTS = 4  # per thread, so that one with slower trials does not keep the others waiting
COMPILED = (
    *(Simulation, Network, NeuronGroup, Projection, Plasticity, Dopamine, Homeostasis),
    *(Coding, World, RangeSensor, nn.ModuleDict),
)


class FusedEngine:
    """Compiled for the CPU; works in place on the tensors that the modules hold.

    Args:
        threads: how many share the trials; 0 is one per processor.
    """

    name = "fused"

    def __init__(self, threads: int = 0) -> None:
        self.threads = threads or _processors()
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        self._topologies: WeakKeyDictionary[Network, tuple[SynapseTable, dict[str, Any]]] = WeakKeyDictionary()

    def run(self, simulation: Simulation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.Engine`."""
        network = simulation.network
        parts = (*simulation.coding.modules(), *simulation.world.modules(), *simulation.world.ranges.values())
        _check_compiled(simulation, *parts)
        arrays = self._network(network)
        world, coding = _world(simulation.world), _coding(simulation.coding, network, simulation.world)
        spikes = _raster(raster, network)
        time = int(network.time)

        def part(low: int, high: int) -> None:
            run_ticks(arrays, world, coding, low, high, time, ticks, spikes)

        self._spread(part, network.trials)
        network.time += ticks * coding.tick

    def run_network(
        self,
        network: Network,
        injected: Tensor,
        sign: Tensor | None = None,
        raster: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> None:
        """Open loop; see `snnrl.engines.Engine`."""
        network.check_reward(reward)
        arrays = self._network(network)
        signs = torch.ones(network.trials, dtype=network.dtype) if sign is None else sign
        rewards = network.pending.new_zeros(0, network.trials) if reward is None else reward.to(network.dtype)
        current, spikes = injected.contiguous().numpy(), _raster(raster, network)
        time = int(network.time)

        def part(low: int, high: int) -> None:
            run_network(arrays, low, high, time, current, signs.numpy(), spikes, rewards.contiguous().numpy())

        self._spread(part, network.trials)
        network.time += len(injected)

    def _spread(self, part: Callable[[int, int], None], trials: int) -> None:
        """Call `part` for ranges of trials, on all threads.

        Those that run at the same time lie far apart: small tensors hold several trials in one cache line.
        """
        if self._pool is None or trials == 1:
            part(0, trials)
            return
        parts = min(trials, self.threads * PARTS)
        ranges = list(pairwise(trials * k // parts for k in range(parts + 1)))
        ordered = [ranges[k] for first in range(PARTS) for k in range(first, parts, PARTS)]
        for done in [self._pool.submit(part, *chosen) for chosen in ordered]:
            done.result()

    def _network(self, network: Network) -> NetworkArrays:
        if network.device.type != "cpu":
            raise ConfigError("engine", self.name, f"runs on device=cpu only, not on {network.device}")
        _check_compiled(*network.modules(), network.plasticity, *network.homeostasis.values())
        known = self._topologies.get(network)
        if known is None or known[0] is not network.synapses:  # new tables where the network was moved or cast
            known = self._topologies[network] = (network.synapses, _topology(network))
        neurons, synapses, dopamine = network.neurons, network.synapses, network.dopamine
        state = {
            "pending": network.pending,
            "spike_count": network.spike_count,
            "weight": synapses.weight,
            "eligibility": synapses.eligibility,
            "level": network.pending.new_zeros(network.trials) if dopamine is None else dopamine.level,
            "total": torch.zeros(network.trials, dtype=torch.float64) if dopamine is None else dopamine.total,
            "released": network.spike_count.new_zeros(network.trials, 1) if dopamine is None else dopamine.released,
            "trials": network.draws.trials,
        }
        for key in ("v", "u", "a", "b", "c", "d", "last_spike"):
            state[key] = getattr(neurons, key)
        return NetworkArrays(**{key: tensor.numpy() for key, tensor in state.items()}, **known[1])


def _check_compiled(*parts: object) -> None:
    """Raise ConfigError for a part of the model with code of its own, of which the kernels know nothing."""
    for part in parts:
        if type(part) not in COMPILED:
            raise ConfigError("engine", "fused", f"cannot run {type(part).__name__}; use engine=reference")
        for name in vars(part):
            if callable(getattr(type(part), name, None)):
                changed = f"{type(part).__name__}.{name}"
                raise ConfigError("engine", "fused", f"cannot run a changed {changed}; use engine=reference")


def _processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _raster(raster: Tensor | None, network: Network) -> Any:
    if raster is None:
        return np.zeros((0, network.trials, network.size), np.uint8)
    raster.zero_()
    return raster.numpy().view(np.uint8)


def _topology(network: Network) -> dict[str, Any]:
    """Everything about a network that does not change while it runs."""
    real = network.pending.numpy().dtype
    groups, projections = list(network.groups.values()), list(network.projections.values())
    place = {group.name: k for k, group in enumerate(groups)}
    sets = [set(item.projections) for item in network.homeostasis.values()]
    rows, columns, incoming, described = [], [], [], []
    first_row = first_column = first_synapse = first_incoming = 0
    for projection in projections:
        trials, pre_size, post_size = projection.shape
        row = (projection.trial * pre_size + projection.pre_index).numpy()
        rows.append(first_synapse + np.searchsorted(row, np.arange(trials * pre_size)))
        member = [k for k, names in enumerate(sets) if projection.plastic and projection.name in names]
        column_base = -1
        if projection.plastic:
            column = (projection.trial * post_size + projection.post_index).numpy()
            order = np.argsort(column, kind="stable")
            columns.append(first_incoming + np.searchsorted(column[order], np.arange(trials * post_size)))
            incoming.append(first_synapse + order)
            column_base, first_column = first_column, first_column + trials * post_size
            first_incoming += len(order)
        described.append(
            (place[projection.pre], place[projection.post], projection.delay, *(member or [-1]), first_row, column_base)
        )
        first_row += trials * pre_size
        first_synapse += len(row)
    rule, dopamine = network.plasticity, network.dopamine
    decay, baseline, release = (
        (0.0, 0.0, 0.0) if dopamine is None else (dopamine.decay, dopamine.baseline, dopamine.release)
    )
    return {
        "settled": np.zeros(network.synapses.plastic, real),
        "source": (network.synapses.pre % network.size).numpy().astype(np.int32),
        "target": (network.synapses.post % network.size).numpy().astype(np.int32),
        "rows": _joined([*rows, [first_synapse]], np.int64),
        "columns": _joined([*columns, [first_incoming]], np.int64),
        "incoming": _joined(incoming, np.int32),
        "groups": np.array([(g.size, g.start, stream("background", g.name), g.noise != 0.0) for g in groups], np.int64),
        "background": np.array([(group.current, group.noise) for group in groups], real),
        "projections": np.array(described, np.int64).reshape(-1, 6),
        "plastic": sum(projection.plastic for projection in projections),
        "set_limit": network.set_limit.numpy(),
        "set_step": np.array([item.step for item in network.homeostasis.values()], real),
        "gain": _window(rule.potentiation, rule.tau_plus, network.dtype),
        "loss": _window(rule.depression, rule.tau_minus, network.dtype),
        "fading": np.cumprod([1.0, *[rule.decay] * BLOCK]).astype(real),
        "depresses": rule.simultaneous == "depresses",
        "modulated": dopamine is not None,
        "source_group": -1 if dopamine is None or dopamine.source is None else place[dopamine.source],
        "threshold": 0 if dopamine is None else dopamine.threshold,
        "constants": np.array(
            [SQUARE, LINEAR, CONSTANT, 0.5, PEAK, decay, baseline, release, rule.weight_max, network.synaptic_gain],
            real,
        ),
        "seed": np.uint64(network.draws.seed),
    }


def _joined(parts: list[Any], dtype: Any) -> Any:
    return np.concatenate([np.zeros(0, dtype), *parts]).astype(dtype)


def _window(amplitude: float, tau: float, dtype: torch.dtype) -> Any:
    """One half of the STDP window by elapsed ms."""
    return stdp(torch.arange(math.ceil(FORGOTTEN * tau)), amplitude, tau, dtype).numpy()


def _world(world: World) -> WorldArrays:
    sensors = list(world.ranges.values())
    return WorldArrays(
        world.position.numpy(),
        world.heading.numpy(),
        world.items.numpy(),
        world.containers.numpy(),
        world.inside.numpy(),
        world.touches.numpy(),
        world.home.numpy(),
        world.free_items,
        world.food_containers,
        world.side,
        world.item_radius,
        world.container_radius,
        world.axle,
        world.container_speed,
        2**62 if world.poison_from is None else world.poison_from,
        np.array([sensor.reach for sensor in sensors]),
        np.array([sensor.to_border for sensor in sensors]),
        np.array([name == "food" for name in world.ranges]),
        stream("moved", "food"),
        stream("moved", "food_container"),
    )


def _coding(coding: Coding, network: Network, world: World) -> CodingArrays:
    place = {name: k for k, name in enumerate(network.groups)}
    pairs = [coding.ranges[name] for name in world.ranges]
    touches = [coding.touches.get(name) for name in TOUCHES]
    real = network.pending.numpy().dtype.type
    return CodingArrays(
        coding.decoded.numpy(),
        coding.slow,
        coding.fast,
        coding.tick,
        np.array([place[name] for name in coding.motors]),
        np.array([[place[name] for name in pair] for pair in pairs], np.int64).reshape(-1, 2),
        np.array([-1 if name is None else place[name] for name in touches]),
        np.array([[stream("range", name) for name in pair] for pair in pairs], np.int64).reshape(-1, 2),
        np.array([0 if name is None else stream("touch", name) for name in touches]),
        np.array([stream("exploration", name) for name in coding.motors]),
        stream("exploring side"),
        coding.range_pulse.mean,
        real(coding.range_pulse.gain),
        real(coding.touch_pulse.gain),
        poisson_table_size(coding.range_pulse.mean),
        coding.touch_thresholds.numpy(),
        coding.exploration_thresholds.numpy().astype(np.int32),
    )
