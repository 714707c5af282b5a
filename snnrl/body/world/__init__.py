"""The robot's world: geometry of the torus, kinds of objects, sensors, and what happens in a tick."""

from snnrl.body.world.kinds import Kinds
from snnrl.body.world.world import World

__all__ = ["Kinds", "World"]
