"""The closed loop of a network and its world, or its task; the one place where they meet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from snnrl.body.coding import Coding
from snnrl.body.world import World
from snnrl.model.network import Network
from snnrl.tasks.task import Task

if TYPE_CHECKING:
    from snnrl.engines import Engine


class Simulation(nn.Module):
    """A batch of robots in their worlds; its state_dict is the whole dynamic state."""

    def __init__(self, network: Network, coding: Coding, world: World) -> None:
        super().__init__()
        self.network, self.coding, self.world = network, coding, world

    @property
    def trials(self) -> int:
        return self.network.trials

    @property
    def tick_length(self) -> int:
        """ms."""
        return self.coding.tick

    def advance(self, engine: Engine, ticks: int) -> None:
        """As many ticks on an engine."""
        engine.run(self, ticks)

    def act_and_sense(self) -> tuple[Tensor, Tensor]:
        """The part of a control tick that takes no time; the one definition of its order.

        1. Wheel speeds are decoded from the spikes of the last tick.
        2. The robot moves; what it touches is felt, taken and replaced.
        3. The range sensors are read.
        4. Pulses, the exploring side and its current are drawn.

        Returns the currents of the coming tick, [tick, B, N], and the sign of dopamine in it, [B].
        """
        network, world = self.network, self.world
        wheels = self.coding.decode(network)
        touched = world.step(wheels, network.time)
        current = self.coding.encode(network, world.sense(), touched)
        return current, world.sign(network.time).to(network.dtype)

    def tick(self, raster: Tensor | None = None) -> None:
        """One control tick: act and sense, then the network runs for its length (the reference).

        `raster`, bool [tick, b, N], is filled with who fired in the first b trials.
        """
        self.network.run(*self.act_and_sense(), raster)


class TaskSimulation(nn.Module):
    """A batch of networks with a task each; its state_dict is the whole dynamic state."""

    def __init__(self, network: Network, task: Task) -> None:
        super().__init__()
        self.network, self.task = network, task

    @property
    def trials(self) -> int:
        return self.network.trials

    @property
    def tick_length(self) -> int:
        """ms."""
        return self.task.tick

    def advance(self, engine: Engine, ticks: int) -> None:
        """As many ticks on an engine; the one definition of a tick's order.

        1. The task gives the currents and the dopamine of the tick.
        2. The network runs for the length of the tick.
        3. The task sees who fired.
        """
        fired = torch.zeros(
            self.task.tick, self.trials, self.network.size, dtype=torch.bool, device=self.network.device
        )
        for _ in range(ticks):
            current, reward = self.task.begin(self.network)
            engine.run_network(self.network, current, None, fired, reward)
            self.task.finish(self.network, fired)
