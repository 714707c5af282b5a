"""Binds modules to the compiled kernels and spreads trials over threads."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import chain, pairwise
from operator import is_
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor, nn

from snnrl.body.coding import Coding
from snnrl.body.robot import Robot
from snnrl.body.world import World
from snnrl.engines.fused.coding import CodingArrays, coding_arrays, run_robot
from snnrl.engines.fused.compiler import Program, announced
from snnrl.engines.fused.modulators import releasing
from snnrl.engines.fused.network import run_network
from snnrl.engines.fused.neurons import stepping
from snnrl.engines.fused.plasticity import bounding
from snnrl.engines.fused.poisson import room
from snnrl.engines.fused.vectors import LANES
from snnrl.engines.fused.work import State, Work, work_for
from snnrl.engines.fused.world import WorldArrays, world_arrays
from snnrl.engines.interface import Given, Situation
from snnrl.engines.layout import MILLISECONDS, Functions, Tables, Topology, real_of, tables, topology
from snnrl.engines.reference import run_ticks
from snnrl.errors import ConfigError
from snnrl.model.modulators import Modulator
from snnrl.model.network import Network, SynapseTable
from snnrl.model.neurons import NeuronGroup
from snnrl.model.synapses import Projection

Arrays = TypeVar("Arrays")
Part = Callable[[int, int], None]  # runs the trials from one to another
PARTS = 4  # per thread, so that one with slower trials does not keep the others waiting
COMPILED = (
    *(Network, NeuronGroup, Projection, Modulator),
    *(Robot, Coding, World, nn.ModuleDict),
)


@dataclass
class _Bound:
    """What is kept of a network from one run to the next, as long as it is the same."""

    synapses: SynapseTable
    topology: Topology
    described: tuple[Any, ...]
    tables: Tables
    functions: Functions
    works: dict[int, deque[Work]] = field(default_factory=dict)
    checked: list[Any] = field(default_factory=list)
    arrays: WeakKeyDictionary[nn.Module, tuple[list[Any], Any]] = field(default_factory=WeakKeyDictionary)

    def shared(self, module: nn.Module, holds: list[Any], make: Callable[[], Arrays]) -> Arrays:
        """The arrays of a module: those of the last time if what it `holds` is the same, else new ones."""
        before, arrays = self.arrays.get(module, ([], None))
        if len(before) != len(holds) or not all(map(is_, before, holds)):
            arrays = make()
            self.arrays[module] = holds, arrays
        return arrays


class FusedEngine:
    """Compiled for the CPU; works in place on the tensors that the modules hold.

    Args:
        threads: how many share the trials; 0 is one per processor.
    """

    name = "fused"

    def __init__(self, threads: int = 0) -> None:
        self.threads = threads or _processors()
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        self._bound: WeakKeyDictionary[Network, _Bound] = WeakKeyDictionary()

    def prepare(self, network: Network, situation: Situation, compiling: Callable[[], None]) -> None:
        """Compile, or read from the disk; see `snnrl.engines.interface.Engine`."""
        if isinstance(situation, Robot):
            kernel, part = self._robot_part(network, situation, 0, None)
        else:
            kernel, part = self._network_part(network, network.pending.new_zeros(0, network.trials, network.size))
        with announced(kernel, compiling):
            part(0, 0)  # of no trial

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.interface.Engine`. A robot is compiled whole; of another situation, only
        the network is.
        """
        if not isinstance(situation, Robot):
            run_ticks(self, network, situation, ticks, raster)
            return
        _, part = self._robot_part(network, situation, ticks, raster)
        self._spread(part, network.trials)
        network.time += ticks * situation.coding.tick

    def _robot_part(self, network: Network, situation: Robot, ticks: int, raster: Tensor | None) -> tuple[Any, Part]:
        """The kernel, and what calls it for a range of trials."""
        check_compiled(self.name, *situation.modules())
        bound = self.bind(network)
        state, clock = _state_of(bound, network)
        world, coding = _robot_of(bound, network, situation)
        size, kinds = room(coding.range_mean), len(world.effect)
        kernel = kernels(bound.functions, real_of(network))[1]
        spikes, time, none = _raster(raster, network), int(clock), np.zeros((0, 1), real_of(network))
        bound.works.setdefault(coding.tick, deque())

        def part(low: int, high: int) -> None:
            works = bound.works[coding.tick]
            work = works.pop() if works else self._work(bound, network, coding.tick)
            scratch = np.zeros(size), np.zeros(kinds, np.int64), np.zeros(1, real_of(network))
            kernel(bound.tables, state, work, world, coding, *scratch, low, high, time, ticks, spikes, none)
            works.append(work)

        return kernel, part

    def run_network(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> None:
        """Open loop; see `snnrl.engines.interface.Engine`."""
        network.check_reward(reward)
        _, part = self._network_part(network, injected, sign, raster, reward)
        self._spread(part, network.trials)
        network.time += len(injected)

    def _network_part(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> tuple[Any, Part]:
        """The kernel, and what calls it for a range of trials."""
        bound = self.bind(network)
        state, clock = _state_of(bound, network)
        kernel = kernels(bound.functions, real_of(network))[0]
        signs = torch.ones(network.trials, dtype=network.dtype) if sign is None else sign
        rewards = network.pending.new_zeros(0, network.trials) if reward is None else reward.to(network.dtype)
        given = [tensor.contiguous().numpy() for tensor in (injected, signs)]
        spikes, time, rewarded = _raster(raster, network), int(clock), rewards.contiguous().numpy()
        bound.works.setdefault(MILLISECONDS, deque())

        def part(low: int, high: int) -> None:
            works = bound.works[MILLISECONDS]
            work = works.pop() if works else self._work(bound, network, MILLISECONDS)
            kernel(bound.tables, state, work, low, high, time, *given, spikes, rewarded)
            works.append(work)

        return kernel, part

    def _spread(self, part: Part, trials: int) -> None:
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

    def bind(self, network: Network) -> _Bound:
        """What the kernels know of a network."""
        if network.device.type != "cpu":
            raise ConfigError("engine", self.name, f"runs on device=cpu only, not on {network.device}")
        known, described = self._bound.get(network), describe(network)
        parts = list(network.modules())
        # a method that is replaced is one entry more
        checked = [*parts, *map(type, parts), *(len(vars(part)) for part in parts)]
        if known is None or known.checked != checked:
            check_compiled(self.name, *parts)
        # new tables where the network was moved or cast, or anything of it exchanged
        if known is None or known.synapses is not network.synapses or known.described != described:
            same = known is not None and known.synapses is network.synapses
            found = known.topology if known and same else topology(network, LANES)
            made = tables(network, found, LANES)
            _note(made[1])
            known = self._bound[network] = _Bound(network.synapses, found, described, *made)
        known.checked = checked
        return known

    @staticmethod
    def _work(bound: _Bound, network: Network, rows: int) -> Work:
        return work_for(bound.tables, len(network.neurons.columns), network.slots, rows, real_of(network))


NOTHING = {"release": 0.0, "threshold": 0.0}
MODULATOR = ("level", "total", "pending", "rate")  # in the order of `State`


def _state_of(bound: _Bound, network: Network) -> tuple[State, Any]:
    """A network's tensors as arrays, and its time."""
    modulators = list(network.modulators.values()) or [_no_modulator(network.dtype)]
    tensors = [network.neurons.packed, network.neurons.last_spike, network.pending, network.spike_count]
    tensors += [network.synapses.weight, network.synapses.eligibility]
    held = [[getattr(modulator, key) for modulator in modulators] for key in MODULATOR]

    def made() -> tuple[State, Any]:
        arrays = [tensor.numpy() for tensor in tensors]
        levels = [tuple(tensor.numpy() for tensor in each) for each in held]
        return State(*arrays, bound.topology.settled, *levels), network.time.numpy()

    return bound.shared(network, [*tensors, *chain(*held), network.time], made)


def _robot_of(bound: _Bound, network: Network, robot: Robot) -> tuple[WorldArrays, CodingArrays]:
    """A robot's world and coding as arrays."""
    held = [item for part in (robot.world, robot.coding) for item in (*vars(part).values(), *part.buffers(False))]
    return bound.shared(
        robot, held, lambda: (world_arrays(robot.world), coding_arrays(robot.coding, network, robot.world))
    )


@cache
def _no_modulator(dtype: torch.dtype) -> Modulator:
    """In place of those that a network does not have: a kernel's tuples cannot be empty."""
    return Modulator("none", {"count": ""}, 1, 0.0, 1.0, 1, NOTHING, dtype, "cpu")


@cache
def kernels(functions: Functions, real: Any) -> tuple[Any, Any]:
    """`run_network` and `run_robot`, compiled for networks of these functions."""
    program = Program(real, {**stepping(functions), **releasing(functions), **bounding(functions)})
    return program.kernel(run_network), program.kernel(run_robot)


def _note(functions: Functions) -> None:
    """Say once of each weight rule that does not add up what that costs."""
    for rule, _ in functions.weight_rules:
        if not getattr(rule, "additive", False) and rule not in _NOTED:
            _NOTED.add(rule)
            warnings.warn(
                f"engine=fused: {rule.__name__} is not declared additive, so every synapse that learns by it is "
                "updated in every ms (see snnrl.model.plasticity.additive)",
                stacklevel=2,
            )


_NOTED: set[Callable[..., Any]] = set()


def describe(network: Network) -> tuple[Any, ...]:
    """Everything that tables are made from and that may be exchanged between two runs."""
    return (
        network.synaptic_gain,
        (network.draws.seed, id(network.draws.trials)),
        [(name, item) for name, item in network.homeostasis.items()],
        [(p.rule, p.listens) for p in network.projections.values()],
        [(g.model, g.current, g.noise, g.gaussian, g.kick, g.kick_rate) for g in network.groups.values()],
        [
            (m.sources, m.released, m.values, m.baseline, m.tau, m.delay, m.smoothing, m.signed, m.reward)
            for m in network.modulators.values()
        ],
    )


def check_compiled(engine: str, *parts: nn.Module) -> None:
    """Raise ConfigError for a part of the model with code of its own, of which the kernels know nothing."""
    for part in parts:
        if type(part) not in COMPILED:
            raise ConfigError("engine", engine, f"cannot run {type(part).__name__}; use engine=reference")
        kind: Any = type(part)
        for name in vars(part).keys() & _methods(kind):
            changed = f"{type(part).__name__}.{name}"
            raise ConfigError("engine", engine, f"cannot run a changed {changed}; use engine=reference")


@cache
def _methods(kind: type) -> set[str]:
    """Names of all that can be called on objects of a type."""
    return {name for name in dir(kind) if callable(getattr(kind, name, None))}


def _processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _raster(raster: Tensor | None, network: Network) -> Any:
    if raster is None:
        return np.zeros((0, network.trials, network.size), np.uint8)
    return raster.numpy().view(np.uint8)
