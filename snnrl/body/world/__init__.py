"""The robot's world: geometry of the torus, sensors, and what happens in a tick."""

from snnrl.body.world.sensors import RangeSensor
from snnrl.body.world.world import TOUCHES, World

__all__ = ["TOUCHES", "RangeSensor", "World"]
