"""The robot without its brain: what it senses, how it moves, and what that earns; for any agent."""

from __future__ import annotations

import torch
from torch import Tensor

from snnrl.body.coding import wheel_speeds
from snnrl.body.world.kinds import TAKEN
from snnrl.configuration.builder import build_world
from snnrl.engines import compiled_world
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws
from snnrl.schema import Config

LEFT, STRAIGHT, RIGHT = range(3)  # the wheel choices


class Foraging:
    """A batch of robots in the world of `config`, in the same control ticks as the spiking robot's.

    Args:
        config: whose world, sensors, wheel speeds, tick and engine are used; the rest is the brain's. On the CPU the
            world is compiled, unless `engine` is reference.
        draws: owner of all positions; its trials are the batch.

    Attributes:
        senses: what the R range sensors (left, right) see and the T touch sensors felt in the last tick, float64
            [B, 2 R + T] in [0, 1].
        taken: items of food and of poison since the start, int64 [B, 2].
        time: int64 scalar, ms.

    Raises:
        ConfigError: if the robot has no range sensor.
    """

    def __init__(self, config: Config, draws: Draws) -> None:
        self.coding, world = config.body()
        if not self.coding.ranges:
            raise ConfigError("coding.ranges", "{}", "an agent needs at least one range sensor")
        self.world = build_world(world, self.coding, draws)
        device = draws.trials.device
        self.taken = torch.zeros(len(draws.trials), 2, dtype=torch.int64, device=device)
        self.time = torch.zeros((), dtype=torch.int64, device=device)
        lead = torch.arange(LEFT, RIGHT + 1, device=device).double() - STRAIGHT
        self._speeds = torch.stack(wheel_speeds(lead, self.coding.slow, self.coding.fast), 1)
        sensors = tuple(self.coding.ranges), tuple(self.coding.touches)
        self._compiled = compiled_world(config.engine, self.world, *sensors)
        nothing = dict.fromkeys(self.coding.touches, torch.zeros(len(draws.trials), device=device))
        self.senses = self._sensed(nothing) if self._compiled is None else self._compiled.sense()

    def ranges(self) -> Tensor:
        """The range sensors, left and right, float64 [B, R, 2] in [0, 1]."""
        count = len(self.coding.ranges)
        return self.senses[:, : 2 * count].unflatten(1, (count, 2))

    def wheels(self, choice: Tensor) -> Tensor:
        """Wheel speeds (cm/s), float64 [B, 2], of LEFT, STRAIGHT or RIGHT, int64 [B]."""
        return self._speeds.index_select(0, choice)

    def step(self, wheels: Tensor) -> Tensor:
        """Move through one tick at these wheel speeds (cm/s), [B, 2].

        Returns the reward, float64 [B]: +1 for each item of food taken, -1 for each of poison.
        """
        if self._compiled is not None:
            self.senses, reward = self._compiled.step(wheels, int(self.time), self.taken)
        else:
            reward = self._step(wheels)
        self.time += self.coding.tick
        return reward

    def _step(self, wheels: Tensor) -> Tensor:
        """The world's own step, on any device."""
        before = self.world.touches.clone()
        touched = self.world.step(wheels, self.time)
        self.senses = self._sensed(touched)
        taken = (self.world.touches - before) * (self.world.kinds.effect == TAKEN)
        value = self.world.value(self.time)
        self.taken += torch.stack([(taken * (sign * value > 0)).sum(1) for sign in (1, -1)], 1)
        return (taken * value).sum(1)

    def _sensed(self, touched: dict[str, Tensor]) -> Tensor:
        """What the world's own sensors say."""
        seen = self.world.sense()
        felt = [touched[name][:, None].double() for name in self.coding.touches]
        return torch.cat([*(seen[name] for name in self.coding.ranges), *felt], 1)
