"""The reference engine: plain torch on any device."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from snnrl.engines.interface import Engine, Given, Situation
from snnrl.model.network import Network


def run_ticks(engine: Engine, network: Network, situation: Situation, ticks: int, raster: Tensor | None) -> None:
    """`Engine.run` by means of the engine's `run_network`, as its order is written there."""
    tick = situation.tick
    fired = network.spike_count.new_zeros(
        (tick, network.trials if situation.watches else 0, network.size), dtype=torch.bool
    )
    for k in range(ticks):
        shown = fired if raster is None else raster[k * tick : (k + 1) * tick]
        current, sign, reward = situation.begin(network)
        engine.run_network(network, current, sign, fired if situation.watches else shown, reward)
        if situation.watches:
            situation.finish(network, fired)
            shown.copy_(fired[:, : shown.shape[1]])


class ReferenceEngine:
    """Runs `Network.step` as it is written."""

    name = "reference"

    def prepare(self, network: Network, situation: Situation, compiling: Callable[[], None]) -> None:
        """There is nothing to prepare."""

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.interface.Engine`."""
        run_ticks(self, network, situation, ticks, raster)

    def run_network(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> None:
        """Open loop; see `snnrl.engines.interface.Engine`."""
        network.run(injected, sign, raster, reward)
