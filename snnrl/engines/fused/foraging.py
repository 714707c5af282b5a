"""`World.step` and `World.sense` for all trials of a batch, compiled: a world without a network."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from snnrl.body.world import World
from snnrl.body.world.kinds import TAKEN, sign_at
from snnrl.engines.fused.compiler import Program
from snnrl.engines.fused.engine import check_compiled
from snnrl.engines.fused.world import sense, step_world, world_arrays

PRECISION = torch.float64


class CompiledWorld:
    """Moves and senses in place on the tensors of a world on the CPU.

    Args:
        world: of B trials.
        ranges, touches: names of the R range and T touch sensors, in the order of what is returned.

    Raises:
        ConfigError: if the world has code of its own.
    """

    def __init__(self, world: World, ranges: Sequence[str], touches: Sequence[str]) -> None:
        check_compiled("fused", world)
        names, sensors = list(world.kinds.names), list(world.config.ranges)
        self._arrays, self._trials = world_arrays(world), world.draws.trials.numpy()
        self._seed = world.draws.seed
        self._sensors = np.array([sensors.index(name) for name in ranges], np.int64)
        self._felt = np.array([names.index(name) for name in touches], np.int64)
        self._counts = np.zeros(len(names), np.int64)
        self._shape = len(self._trials), 2 * len(ranges) + len(touches)
        self._step, self._sense = kernels()

    def step(self, wheels: Tensor, time: int, taken: Tensor) -> tuple[Tensor, Tensor]:
        """`World.step` through one tick, and what the robots sense then.

        Args:
            wheels: speed of the left and right wheel, float64 [B, 2], cm/s.
            time: ms.
            taken: to which the items of food and of poison that are taken are added, int64 [B, 2].

        Returns what the sensors say, as `sense` does, and what was taken, each by its sign, summed, float64 [B].
        """
        trials = len(self._trials)
        senses, value = np.zeros(self._shape), np.empty(trials)
        speeds = wheels.double().expand(trials, 2).contiguous().numpy()
        sensors, felt, counts, items = self._sensors, self._felt, self._counts, taken.numpy()
        self._step(self._arrays, self._seed, self._trials, speeds, time, sensors, felt, counts, senses, items, value)
        return torch.from_numpy(senses), torch.from_numpy(value)

    def sense(self) -> Tensor:
        """The range sensors (left, right) from where the robots are now, and zeros for touch, float64 [B, 2 R + T]."""
        senses = np.zeros(self._shape)
        self._sense(self._arrays, self._sensors, senses)
        return torch.from_numpy(senses)


@cache
def kernels() -> tuple[Any, Any]:
    """`step_trials` and `sense_trials`, compiled."""
    program = Program(np.float64, {})
    return program.kernel(step_trials), program.kernel(sense_trials)


def step_trials(world, seed, trials, wheels, time, sensors, felt, counts, senses, taken, value):
    """All trials through one tick; `senses` are zeros before, and `counts`, int64 [K], is scratch."""
    for trial in range(len(trials)):
        step_world(world, seed, trials[trial], trial, wheels[trial, 0], wheels[trial, 1], time, counts)
        for sensor in range(len(felt)):
            senses[trial, 2 * len(sensors) + sensor] = min(counts[felt[sensor]], 1)
        total = 0.0
        for k in range(len(counts)):
            if counts[k] > 0 and world.effect[k] == TAKEN:
                sign = sign_at(time, world.signs[k], world.turns[k], world.again[k])
                taken[trial, 0] += counts[k] * (sign > 0)
                taken[trial, 1] += counts[k] * (sign < 0)
                total += counts[k] * sign
        value[trial] = total
        sense_all(world, trial, sensors, senses)


def sense_trials(world, sensors, senses):
    """The range sensors of all trials."""
    for trial in range(len(senses)):
        sense_all(world, trial, sensors, senses)


def sense_all(world, trial, sensors, senses):
    """The range sensors of one trial."""
    for sensor in range(len(sensors)):
        left, right = sense(world, trial, sensors[sensor])
        senses[trial, 2 * sensor], senses[trial, 2 * sensor + 1] = left, right
