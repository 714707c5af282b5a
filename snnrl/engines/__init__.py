"""Engines: different ways to run the same simulation, behind one interface."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from snnrl.configuration.schema import ConfigError
from snnrl.engines.reference import ReferenceEngine
from snnrl.model.network import Network
from snnrl.simulation import Simulation


class Engine(Protocol):
    """What every engine can do; all results are in the modules' tensors afterwards."""

    name: str

    def run(self, simulation: Simulation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop: `ticks` control ticks. `raster`, bool [ticks * tick, b, N], is filled: the first b trials'."""

    def run_network(
        self,
        network: Network,
        injected: Tensor,
        sign: Tensor | None = None,
        raster: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> None:
        """Open loop: `Network.run`."""


def make_engine(name: str, device: str, threads: int = 0) -> Engine:
    """The engine of that name; `auto` is the fused one on the CPU, the reference elsewhere.

    Raises:
        ConfigError: if the fused engine is asked for a device that it cannot run on.
    """
    on_cpu = device == "cpu"
    if name == "fused" and not on_cpu:
        raise ConfigError("engine", name, f"runs on device=cpu only, not on device={device}")
    if name == "reference" or not on_cpu:
        return ReferenceEngine()
    from snnrl.engines.fused import FusedEngine

    return FusedEngine(threads)


__all__ = ["Engine", "ReferenceEngine", "make_engine"]
