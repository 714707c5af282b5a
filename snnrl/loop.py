"""The closed loop of network and world; the one place where they meet."""

from __future__ import annotations

from torch import Tensor, nn

from snnrl.coding import Coding
from snnrl.network import Network
from snnrl.world import World


class Simulation(nn.Module):
    """A batch of robots in their worlds; its state_dict is the whole dynamic state."""

    def __init__(self, network: Network, coding: Coding, world: World) -> None:
        super().__init__()
        self.network, self.coding, self.world = network, coding, world

    @property
    def trials(self) -> int:
        return self.network.trials

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
