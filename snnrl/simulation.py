"""A network in a situation: a robot in its world, or a task; the one place where the two meet."""

from __future__ import annotations

from typing import Generic, TypeVar

from torch import Tensor, nn

from snnrl.engines import Engine, Situation
from snnrl.model.network import Network

S = TypeVar("S", bound=Situation)


class Simulation(nn.Module, Generic[S]):
    """A batch of networks, each in its situation; its state_dict is the whole dynamic state."""

    situation: S

    def __init__(self, network: Network, situation: S) -> None:
        super().__init__()
        self.network, self.situation = network, situation

    def run(self, engine: Engine, ticks: int, raster: Tensor | None = None) -> None:
        """As many ticks on an engine; see `snnrl.engines.Engine.run`."""
        engine.run(self.network, self.situation, ticks, raster)

    @property
    def trials(self) -> int:
        return self.network.trials

    @property
    def tick(self) -> int:
        """ms."""
        return self.situation.tick

    @property
    def seconds(self) -> float:
        """Simulated so far."""
        return int(self.network.time) / 1000.0
