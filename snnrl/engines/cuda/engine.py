"""Binds modules to the compiled kernels, and launches these."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numba import cuda
from numba.core.errors import NumbaError
from torch import Tensor

from snnrl.body.robot import Robot
from snnrl.engines.cuda.coding import run_robot
from snnrl.engines.cuda.compiler import SIMULATED, Program, unfused
from snnrl.engines.cuda.network import Described, run_network
from snnrl.engines.cuda.neurons import stepping
from snnrl.engines.cuda.work import State, put_back, scratch_for, side_by_side, wiring_of
from snnrl.engines.fused.coding import coding_arrays
from snnrl.engines.fused.engine import check_compiled, describe
from snnrl.engines.fused.modulators import releasing
from snnrl.engines.fused.plasticity import bounding
from snnrl.engines.fused.world import world_arrays
from snnrl.engines.interface import Situation
from snnrl.engines.layout import Functions, Tables, Topology, real_of, tables, topology
from snnrl.engines.reference import run_ticks
from snnrl.errors import ConfigError
from snnrl.model.draws import poisson_table_size
from snnrl.model.network import Network, SynapseTable

LANES = 4 if SIMULATED else 256  # most threads of a block; each of the simulator's is one of Python's
LEAST = 4 if SIMULATED else 32
TICKS = 100  # of a launch at most: the interpreter cannot be interrupted before it ends


@dataclass
class _Bound:
    """What is kept of a network from one run to the next, as long as it is the same."""

    synapses: SynapseTable
    topology: Topology
    described: tuple[Any, ...]
    tables: Tables
    functions: Functions
    arrays: Described


class CudaEngine:
    """Compiled for NVIDIA GPUs, a block of threads for each trial; works in place on the modules' tensors.

    In numba's simulator it runs on tensors of the CPU.

    Raises:
        ConfigError: there is no GPU.
    """

    name = "cuda"

    def __init__(self) -> None:
        if not cuda.is_available():
            raise ConfigError("engine", self.name, "finds no NVIDIA GPU and its driver on this machine")
        self.device = "cpu" if SIMULATED else "cuda"
        self._bound: WeakKeyDictionary[Network, _Bound] = WeakKeyDictionary()

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.interface.Engine`. A robot is compiled whole; of another situation, only
        the network is.
        """
        if not isinstance(situation, Robot):
            run_ticks(self, network, situation, ticks, raster)
            return
        check_compiled(self.name, *situation.modules())
        bound = self._bind(network)
        coding, world = situation.coding, situation.world
        largest, tick = poisson_table_size(coding.config.range_mean), coding.tick
        arrays = [
            _on_device(part, network.device)
            for part in (world_arrays(world, _array), coding_arrays(coding, network, world, _array))
        ]
        kinds, sensors = len(world.kinds.names), len(world.config.ranges)
        lanes = _lanes(network)
        scratch = _on_device(scratch_for(network, bound.tables, lanes, kinds, sensors), network.device)
        modulators, spikes = side_by_side(network, bound.tables), _raster(raster, network)
        kernel = kernels(bound.functions, real_of(network))[1]
        state, time = _state(network, modulators), int(network.time)
        for first in range(0, ticks, TICKS):
            count = min(TICKS, ticks - first)
            shown = _array(spikes[first * tick : (first + count) * tick])
            given = (bound.arrays, state, scratch, *arrays, largest, time + first * tick, count, shown)
            _launch(kernel, network.trials, lanes, given)
        put_back(network, modulators)
        network.time += ticks * tick

    def run_network(
        self,
        network: Network,
        injected: Tensor,
        sign: Tensor | None = None,
        raster: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> None:
        """Open loop; see `snnrl.engines.interface.Engine`."""
        network.check_reward(reward)
        bound = self._bind(network)
        signs = torch.ones(network.trials, dtype=network.dtype, device=network.device) if sign is None else sign
        rewards = network.pending.new_zeros(0, network.trials) if reward is None else reward.to(network.dtype)
        given = [_array(tensor.to(network.dtype).contiguous()) for tensor in (injected, signs)]
        lanes = _lanes(network)
        scratch = _on_device(scratch_for(network, bound.tables, lanes, 0, 0), network.device)
        modulators, spikes = side_by_side(network, bound.tables), _array(_raster(raster, network))
        kernel = kernels(bound.functions, real_of(network))[0]
        state, time = _state(network, modulators), int(network.time)
        rewarded = _array(rewards.contiguous())
        _launch(kernel, network.trials, lanes, (bound.arrays, state, scratch, time, *given, spikes, rewarded))
        put_back(network, modulators)
        network.time += len(injected)

    def _bind(self, network: Network) -> _Bound:
        if network.device.type != self.device:
            raise ConfigError("engine", self.name, f"runs on device={self.device} only, not on {network.device}")
        check_compiled(self.name, *network.modules())
        known, described = self._bound.get(network), describe(network)
        # new tables where the network was moved or cast, or anything of it exchanged
        if known is None or known.synapses is not network.synapses or known.described != described:
            same = known is not None and known.synapses is network.synapses
            found = known.topology if known and same else topology(network, 1)
            made, functions = tables(network, found, 1)
            arrays = Described(*(_on_device(part, network.device) for part in (made, wiring_of(network, made))))
            known = _Bound(network.synapses, found, described, made, functions, arrays)
            self._bound[network] = known
        return known


@cache
def kernels(functions: Functions, real: Any) -> tuple[Any, Any]:
    """`run_network` and `run_robot`, compiled for networks of these functions."""
    program = Program(real, {**stepping(functions), **releasing(functions), **bounding(functions)})
    return program.kernel(run_network), program.kernel(run_robot)


def _launch(kernel: Any, trials: int, lanes: int, given: Iterable[Any]) -> None:
    """Run a kernel, and wait until it has ended."""
    with unfused(), warnings.catch_warnings():
        if SIMULATED:
            warnings.simplefilter("ignore", RuntimeWarning)  # of NumPy, where a compiled number just overflows
        try:
            kernel[trials, lanes](*given)
        except NumbaError as error:
            line = str(error).strip().splitlines()[-1]
            raise ConfigError("engine", "cuda", f"cannot compile it ({line}); use engine=reference") from error
    cuda.synchronize()


def _lanes(network: Network) -> int:
    """Threads of a block: a power of two, and no more than there are neurons, as far as that is possible."""
    lanes = LEAST
    while lanes < min(LANES, network.size):
        lanes *= 2
    return lanes


def _state(network: Network, modulators: dict[str, Tensor]) -> State:
    neurons, synapses = network.neurons, network.synapses
    own = (neurons.packed, neurons.last_spike, network.pending, network.spike_count)
    learnt = (synapses.weight, synapses.eligibility)
    return State(*map(_array, (*own, *learnt)), **{key: _array(value) for key, value in modulators.items()})


def _array(tensor: Tensor) -> Any:
    """An array for kernels that shares memory with a tensor."""
    return tensor.numpy() if SIMULATED else cuda.as_cuda_array(tensor)


def _on_device(part: Any, device: torch.device) -> Any:
    """A tuple whose tensors and NumPy arrays are arrays for kernels, the latter as copies."""

    def moved(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            value = torch.from_numpy(np.ascontiguousarray(value)).to(device)
        return _array(value) if isinstance(value, Tensor) else value

    return type(part)(*map(moved, part))


def _raster(raster: Tensor | None, network: Network) -> Tensor:
    """Bytes [T, b, N] that share memory with a raster; without rows if there is none."""
    if raster is None:
        return torch.zeros(0, network.trials, network.size, dtype=torch.uint8, device=network.device)
    return raster.view(torch.uint8)
