"""Binds modules to the compiled kernels, and launches these."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numba import cuda, types
from numba.core.errors import NumbaError
from torch import Tensor

from snnrl.body.robot import Robot
from snnrl.engines.cuda.coding import run_robot
from snnrl.engines.cuda.compiler import SIMULATED, WARP, Program, compiling
from snnrl.engines.cuda.network import Described, run_network
from snnrl.engines.cuda.neurons import spikes_of, stepping
from snnrl.engines.cuda.shape import Shape, names_of
from snnrl.engines.cuda.work import WORD, State, put_back, scratch_for, side_by_side, sizes_of, wiring_of
from snnrl.engines.fused.coding import coding_arrays
from snnrl.engines.fused.engine import check_compiled, describe
from snnrl.engines.fused.modulators import releasing
from snnrl.engines.fused.plasticity import bounding
from snnrl.engines.fused.world import world_arrays
from snnrl.engines.interface import Given, Situation
from snnrl.engines.layout import Functions, Tables, Topology, real_of, tables, topology
from snnrl.engines.reference import run_ticks
from snnrl.errors import ConfigError
from snnrl.model.draws import poisson_table_size
from snnrl.model.network import Network, SynapseTable

LANES = 3 if SIMULATED else 64  # most threads of a block; each of the simulator's is one of Python's
ON_CHIP = 48 * 1024  # bytes of shared memory that every block may have
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

    def prepare(self, network: Network, situation: Situation, compiling: Callable[[], None]) -> None:
        """Kernels are compiled in every process anew, at their first launch."""
        compiling()

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.interface.Engine`. A robot is compiled whole; of another situation, only
        the network is.
        """
        if not isinstance(situation, Robot):
            run_ticks(self, network, situation, ticks, raster)
            return
        check_compiled(self.name, *situation.modules())
        coding, world = situation.coding, situation.world
        largest, tick = poisson_table_size(coding.config.range_mean), coding.tick
        spikes = _raster(raster, network)
        with self._current(network):
            launch = self.launch(network, len(world.kinds.names), len(world.config.ranges))
            arrays = [
                on_device(part, network.device)
                for part in (world_arrays(world, array_of), coding_arrays(coding, network, world, array_of))
            ]
            for first in range(0, ticks, TICKS):
                count = min(TICKS, ticks - first)
                shown = array_of(spikes[first * tick : (first + count) * tick])
                launch(run_robot, count * tick, *arrays, largest, count, shown)

    def run_network(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> None:
        """Open loop; see `snnrl.engines.interface.Engine`."""
        network.check_reward(reward)
        signs = torch.ones(network.trials, dtype=network.dtype, device=network.device) if sign is None else sign
        rewards = network.pending.new_zeros(0, network.trials) if reward is None else reward
        spikes = _raster(raster, network)
        with self._current(network):
            launch = self.launch(network, 0, 0)
            given = [tensor.to(network.dtype).contiguous() for tensor in (injected, signs)]
            rewarded = rewards.to(network.dtype).contiguous()
            launch(run_network, len(injected), *map(array_of, (*given, spikes, rewarded)))

    def _current(self, network: Network) -> AbstractContextManager[Any]:
        """Lets kernels run where the network is."""
        if network.device.type != self.device:
            raise ConfigError("engine", self.name, f"runs on device={self.device} only, not on {network.device}")
        return nullcontext() if SIMULATED else cuda.gpus[network.device.index]

    def launch(self, network: Network, kinds: int, sensors: int) -> Launch:
        """What launches kernels on a network, in a world of so many kinds and range sensors."""
        bound = self._bind(network)
        return Launch(network, bound.tables, bound.functions, bound.arrays, kinds, sensors)

    def _bind(self, network: Network) -> _Bound:
        check_compiled(self.name, *network.modules())
        known, described = self._bound.get(network), describe(network)
        # new tables where the network was moved or cast, or anything of it exchanged
        if known is None or known.synapses is not network.synapses or known.described != described:
            same = known is not None and known.synapses is network.synapses
            found = known.topology if known and same else topology(network, 1, lists=False)
            made, functions = tables(network, found, 1)
            arrays = Described(*(on_device(part, network.device) for part in (made, wiring_of(network, made))))
            known = _Bound(network.synapses, found, described, made, functions, arrays)
            self._bound[network] = known
        return known


class Launch:
    """A network made ready for kernels.

    Args:
        network, tables, functions, arrays: a network and what is known of it.
        kinds, sensors: how many its world has.
    """

    def __init__(
        self, network: Network, tables: Tables, functions: Functions, arrays: Described, kinds: int, sensors: int
    ) -> None:
        self.network, self.lanes = network, _lanes(network)
        self.shape = Shape(
            lanes=self.lanes,
            neurons=network.size,
            words=(network.size >> WORD) + 1,
            groups=len(network.groups),
            runs=len(arrays.wiring.runs),
            sets=len(network.homeostasis),
            modulators=len(network.modulators),
            signals=len(tables.signals),
            phases=len(arrays.wiring.row_of),
            slots=network.slots,
        )
        self.modulators = side_by_side(network, tables)
        learnt, sums = sizes_of(arrays.wiring, self.lanes)
        synapses = 2 * learnt * network.pending.itemsize
        others = 8 * sums + 4 * (2 * self.shape.words + self.shape.groups)
        on_chip = synapses + others <= ON_CHIP
        self.program = program_of(functions, real_of(network), on_chip, self.shape)
        self.shared = -(-(others + (synapses if on_chip else 0)) // 8) * 8
        room = scratch_for(network, arrays.wiring, on_chip, len(tables.signals), self.lanes, kinds, sensors)
        self.given = arrays, _state(network, self.modulators), on_device(room, network.device)

    def __call__(self, kernel: Callable[..., None], steps: int, *given: Any) -> None:
        """Run a kernel for so many ms; the network's modules then have what has become of them."""
        network = self.network
        configuration = network.trials, self.lanes, 0, self.shared
        arguments = (*self.given, int(network.time), *given)
        if not SIMULATED:
            torch.cuda.synchronize(network.device)  # torch may work on another stream
        with compiling(), warnings.catch_warnings():
            if SIMULATED:
                warnings.simplefilter("ignore", RuntimeWarning)  # of NumPy, where a compiled number just overflows
            try:
                _start(self.program.kernel(kernel, LANES), configuration, arguments)
            except NumbaError as error:
                # numba says first where it failed, and in lines further down how it came there; in colour, if it can
                lines = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines()
                reason = next(line for line in lines if line and not line.startswith("Failed in"))
                raise ConfigError("engine", "cuda", f"cannot compile it ({reason}); use engine=reference") from error

        put_back(network, self.modulators)
        network.time += steps


def _start(kernel: Any, configuration: tuple[int, ...], given: tuple[Any, ...]) -> None:
    kernel[configuration](*given)
    cuda.synchronize()


@cache
def program_of(functions: Functions, real: Any, on_chip: bool, shape: Shape) -> Program:
    """Kernels, compiled for networks of these functions and numbers.

    `on_chip` is whether weights and eligibilities are in shared memory while they run.
    """
    element = types.float64 if real is np.float64 else types.float32
    names = {"SHARED": on_chip, "ELEMENT": element, "WIDE": np.dtype(real).itemsize, "spikes_of": spikes_of}
    names |= names_of(shape)
    return Program(real, {**stepping(functions), **releasing(functions), **bounding(functions), **names})


def _lanes(network: Network) -> int:
    """Threads of a block: one for each neuron, in whole warps, as far as a block may have so many."""
    return min(LANES, -(-network.size // WARP) * WARP)


def _state(network: Network, modulators: dict[str, Tensor]) -> State:
    neurons, synapses = network.neurons, network.synapses
    own = (neurons.packed, neurons.last_spike, network.pending, network.spike_count)
    learnt = (synapses.weight, synapses.eligibility)
    return State(*map(array_of, (*own, *learnt)), **{key: array_of(value) for key, value in modulators.items()})


def array_of(tensor: Tensor) -> Any:
    """An array for kernels that shares memory with a tensor."""
    return tensor.numpy() if SIMULATED else cuda.as_cuda_array(tensor)


def on_device(part: Any, device: torch.device) -> Any:
    """A tuple whose tensors and NumPy arrays are arrays for kernels, the latter as copies."""

    def moved(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            value = torch.from_numpy(np.ascontiguousarray(value)).to(device)
        return array_of(value) if isinstance(value, Tensor) else value

    return type(part)(*map(moved, part))


def _raster(raster: Tensor | None, network: Network) -> Tensor:
    """Bytes [T, b, N] that share memory with a raster; without rows if there is none."""
    if raster is None:
        return torch.zeros(0, network.trials, network.size, dtype=torch.uint8, device=network.device)
    return raster.view(torch.uint8)
