"""A robot in its world: the situation of a network that moves a body."""

from __future__ import annotations

from torch import Tensor, nn

from snnrl.body.coding import Coding
from snnrl.body.world import World
from snnrl.model.network import Network


class Robot(nn.Module):
    """What joins a network to a world: sensors, exploration and wheels (`Coding`), and the world itself."""

    watches = False  # wheel speeds are decoded from counts of spikes

    def __init__(self, coding: Coding, world: World) -> None:
        super().__init__()
        self.coding, self.world = coding, world

    @property
    def tick(self) -> int:
        """ms."""
        return self.coding.tick

    def begin(self, network: Network) -> tuple[Tensor, Tensor, None]:
        """The part of a control tick that takes no time; the one definition of its order.

        1. Wheel speeds are decoded from the spikes of the last tick.
        2. The robot moves; what it touches is felt, taken and replaced.
        3. The range sensors are read.
        4. Pulses, the exploring side and its current are drawn.

        Returns the currents of the coming tick, [tick, B, N], and the sign of releases in it, [B].
        """
        wheels = self.coding.decode(network)
        touched = self.world.step(wheels, network.time)
        current = self.coding.encode(network, self.world.sense(), touched)
        return current, self.world.sign.to(network.dtype), None

    def finish(self, network: Network, fired: Tensor) -> None:
        """Nothing is left to do."""
