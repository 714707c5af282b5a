"""The reference engine: plain torch on any device."""

from __future__ import annotations

from torch import Tensor

from snnrl.model.network import Network
from snnrl.simulation import Simulation


class ReferenceEngine:
    """Runs `Simulation.tick` and `Network.step` as they are written."""

    name = "reference"

    def run(self, simulation: Simulation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.Engine`."""
        tick = simulation.coding.tick
        for k in range(ticks):
            simulation.tick(None if raster is None else raster[k * tick : (k + 1) * tick])

    def run_network(
        self,
        network: Network,
        injected: Tensor,
        sign: Tensor | None = None,
        raster: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> None:
        """Open loop; see `snnrl.engines.Engine`."""
        network.run(injected, sign, raster, reward)
